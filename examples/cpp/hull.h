#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

/// A cloud of points to register, three numbers a point, in the hull's own frame.
struct Hull {
    std::vector<double> vertices;
    /// Empty (the centre of mass is taken) or three numbers.
    std::vector<double> contraction_point;
    /// None or at least one of the two.
    std::optional<std::uint32_t> max_vertices = {};
    std::optional<double> max_deviation = {};
    /// None: the server's 1e-6.
    std::optional<double> planarity = {};

    /// The byte string of docs/identity.md.
    std::string identity_bytes() const;
    /// Names the hull on every server: 32 bytes.
    std::string id() const;
};

/// Lower-case hexadecimal digits.
std::string hex(const std::string& bytes);
