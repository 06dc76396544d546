#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

/// A cloud of points to register: three numbers per point, in the hull's own frame.
struct Hull {
    std::vector<double> vertices;
    /// Three numbers; or empty for the centre of mass.
    std::vector<double> contraction_point;
    /// Both absent for no simplification.
    std::optional<std::uint32_t> max_vertices = {};
    std::optional<double> max_deviation = {};
    /// If absent, the server uses 1e-6.
    std::optional<double> planarity = {};

    /// The byte string that docs/identity.md defines.
    std::string identity_bytes() const;
    /// The hull's id on every server: 32 bytes.
    std::string id() const;
};

/// Converts bytes to lower-case hexadecimal digits.
std::string hex(const std::string& bytes);
