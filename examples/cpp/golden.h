#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "hull.h"
#include "hullcast/v1/contacts.pb.h"
#include "vector.h"

/// A hull at its pose.
struct Side {
    std::vector<Vector> vertices;
    Vector contraction_point;
    Vector position;
    Quaternion rotation;

    Hull hull() const;
    /// Largest n . (v - contraction point), n in the world.
    double support(Vector n) const;
};

/// One of tests/golden/contacts.json, which tests/golden/README.md describes.
struct Case {
    std::string name;
    Side a, b;
    double margin;
    std::string outcome;
    double alpha_below, alpha_above, alpha_budget, length_budget;
    std::optional<std::vector<Vector>> patch;
    double patch_budget;

    /// The case's scene and its one pair.
    hullcast::v1::QueryContactsRequest request() const;
    /// Holds the answer of that pair against the exact one; throws where it is another.
    void check(const hullcast::v1::QueryContactsResponse& answer) const;
};

/// One of docs/identity.md.
struct IdentityVector {
    std::string name;
    Hull hull;
    std::string id;
    /// Empty where the page does not give them.
    std::string bytes;
};

std::vector<Case> read_cases(const std::filesystem::path& root);
std::vector<IdentityVector> read_identity_vectors(const std::filesystem::path& root);

/// Throws `otherwise` unless it holds.
void expect(bool holds, const std::string& otherwise);
