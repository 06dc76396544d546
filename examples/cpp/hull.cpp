#include "hull.h"

#include <openssl/sha.h>

#include <bit>

namespace {

template <typename Number>
void put(std::string& bytes, Number number) {
    for (std::size_t i = 0; i < sizeof(Number); ++i) {
        bytes.push_back(static_cast<char>(number >> (8 * i) & 0xff));
    }
}

void put(std::string& bytes, const std::vector<double>& numbers) {
    for (double number : numbers) {
        put(bytes, std::bit_cast<std::uint64_t>(number + 0.0));  // -0.0 is written as 0.0
    }
}

}  // namespace

std::string Hull::identity_bytes() const {
    std::string bytes = "hullcast";
    put(bytes, std::uint32_t{planarity ? 2u : 1u});  // the format's version
    bytes.push_back(contraction_point.empty() ? 0 : 1);
    put(bytes, contraction_point);
    bytes.push_back(max_vertices || max_deviation);
    if (max_vertices || max_deviation) {
        bytes.push_back(max_vertices.has_value());
        if (max_vertices) put(bytes, *max_vertices);
        bytes.push_back(max_deviation.has_value());
        if (max_deviation) put(bytes, std::vector{*max_deviation});
    }
    if (planarity) put(bytes, std::vector{*planarity});
    put(bytes, static_cast<std::uint32_t>(vertices.size() / 3));
    put(bytes, vertices);
    return bytes;
}

std::string Hull::id() const {
    const std::string bytes = identity_bytes();
    std::string digest(SHA256_DIGEST_LENGTH, '\0');
    SHA256(reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size(),
           reinterpret_cast<unsigned char*>(digest.data()));
    return digest;
}

std::string hex(const std::string& bytes) {
    std::string digits;
    for (unsigned char byte : bytes) {
        digits += "0123456789abcdef"[byte >> 4];
        digits += "0123456789abcdef"[byte & 15];
    }
    return digits;
}
