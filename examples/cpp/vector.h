#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <vector>

using Vector = std::array<double, 3>;
/// In the order x, y, z, w.
using Quaternion = std::array<double, 4>;

inline Vector operator+(Vector a, Vector b) { return {a[0] + b[0], a[1] + b[1], a[2] + b[2]}; }
inline Vector operator-(Vector a, Vector b) { return {a[0] - b[0], a[1] - b[1], a[2] - b[2]}; }
inline Vector operator*(Vector a, double s) { return {a[0] * s, a[1] * s, a[2] * s}; }
inline double dot(Vector a, Vector b) { return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]; }
inline double norm(Vector a) { return std::sqrt(dot(a, a)); }
inline Vector cross(Vector a, Vector b) {
    return {a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]};
}

inline Vector rotate(Quaternion q, Vector v) {
    const Vector axis = {q[0], q[1], q[2]};
    const double s = 2 / (dot(axis, axis) + q[3] * q[3]);
    const Vector turned = cross(axis, v);
    return v + turned * (q[3] * s) + cross(axis, turned) * s;
}

inline Quaternion inverse(Quaternion q) { return {-q[0], -q[1], -q[2], q[3]}; }

/// The distance from a point to a convex polygon in space.
inline double distance_to_polygon(Vector p, const std::vector<Vector>& corners) {
    const auto side = [&](std::size_t i) { return corners[(i + 1) % corners.size()] - corners[i]; };
    Vector normal = {};
    for (std::size_t i = 0; i < corners.size(); ++i) {
        normal = normal + cross(corners[i] - corners[0], side(i));
    }
    bool inside = true;
    double nearest = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < corners.size(); ++i) {
        const Vector to = p - corners[i];
        inside = inside && dot(cross(normal, side(i)), to) >= 0;
        const double t = std::clamp(dot(to, side(i)) / dot(side(i), side(i)), 0.0, 1.0);
        nearest = std::min(nearest, norm(to - side(i) * t));
    }
    return inside ? std::abs(dot(p - corners[0], normal)) / norm(normal) : nearest;
}
