#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "hull.h"
#include "hullcast/v1/contacts.pb.h"
#include "vector.h"

/// A hull at a pose.
struct Side {
    std::vector<Vector> vertices;
    Vector contraction_point;
    Vector position;
    Quaternion rotation;

    Hull hull() const;
    /// The largest n . (v - contraction point) over the vertices v; n is in the world frame.
    double support(Vector n) const;
};

/// A case of tests/golden/contacts.json, which tests/golden/README.md describes.
struct Case {
    std::string name;
    Side a, b;
    double margin;
    std::string outcome;
    double alpha_below, alpha_above, alpha_budget, length_budget;
    std::optional<std::vector<Vector>> patch;
    double patch_budget;

    /// The request for the case's scene and its one pair.
    hullcast::v1::QueryContactsRequest request() const;
    /// Compares the answer for that pair with the exact one; throws if they differ.
    void check(const hullcast::v1::QueryContactsResponse& answer) const;
};

/// A test vector of docs/identity.md.
struct IdentityVector {
    std::string name;
    Hull hull;
    std::string id;
    /// Empty if the page does not give the bytes.
    std::string bytes;
};

std::vector<Case> read_cases(const std::filesystem::path& root);
std::vector<IdentityVector> read_identity_vectors(const std::filesystem::path& root);

/// Throws `otherwise` unless `holds` is true.
void expect(bool holds, const std::string& otherwise);
