#include "golden.h"

#include <fstream>
#include <iterator>
#include <nlohmann/json.hpp>
#include <stdexcept>

namespace v1 = hullcast::v1;
using nlohmann::json;

void expect(bool holds, const std::string& otherwise) {
    if (!holds) throw std::runtime_error(otherwise);
}

Hull Side::hull() const {
    Hull hull;
    for (const Vector& v : vertices) hull.vertices.insert(hull.vertices.end(), v.begin(), v.end());
    hull.contraction_point.assign(contraction_point.begin(), contraction_point.end());
    return hull;
}

double Side::support(Vector n) const {
    const Vector local = rotate(inverse(rotation), n);
    double most = -std::numeric_limits<double>::infinity();
    for (const Vector& v : vertices) most = std::max(most, dot(local, v - contraction_point));
    return most;
}

v1::QueryContactsRequest Case::request() const {
    const std::string first = a.hull().id(), second = b.hull().id();
    v1::QueryContactsRequest request;
    request.add_hull_ids(first);
    if (second != first) request.add_hull_ids(second);  // each hull is listed once
    request.add_body_hulls(0);
    request.add_body_hulls(request.hull_ids_size() - 1);
    for (const Side* side : {&a, &b}) {
        request.mutable_positions()->Add(side->position.begin(), side->position.end());
        request.mutable_rotations()->Add(side->rotation.begin(), side->rotation.end());
    }
    for (const int body : {0, 1}) request.add_pairs(body);
    request.set_margin(margin);
    for (const auto output : {v1::OUTPUT_ALPHA, v1::OUTPUT_NORMAL, v1::OUTPUT_POINTS}) {
        request.add_outputs(output);
    }
    return request;
}

namespace {

void check_points(const Case& golden, const v1::QueryContactsResponse& answer) {
    const int count = answer.point_counts(0);
    expect(count > 0 && answer.distances_size() == count && answer.witness_as_size() == 3 * count,
           std::to_string(count) + " points");
    if (!golden.patch) return;
    expect(count >= 3 && !(answer.flags()[0] & v1::FLAG_ESTIMATED), "no patch");
    std::vector<Vector> found;
    for (int i = 0; i < 3 * count; i += 3) {
        found.push_back({answer.witness_as(i), answer.witness_as(i + 1), answer.witness_as(i + 2)});
    }
    double far = 0;
    for (const Vector& p : found) far = std::max(far, distance_to_polygon(p, *golden.patch));
    for (const Vector& p : *golden.patch) far = std::max(far, distance_to_polygon(p, found));
    expect(far <= golden.patch_budget, "the patch is off by " + std::to_string(far));
}

}  // namespace

void Case::check(const v1::QueryContactsResponse& answer) const {
    const auto found = static_cast<v1::Outcome>(answer.outcomes()[0]);
    expect(v1::Outcome_Name(found) == "OUTCOME_" + outcome, "outcome " + v1::Outcome_Name(found));
    expect(answer.alpha_lowers(0) <= alpha_below && answer.alpha_uppers(0) >= alpha_above,
           "the bracket does not hold alpha");
    if (found == v1::OUTCOME_SEPARATED) return;
    // Twice the budgets, because the numbers computed here are rounded too.
    expect(std::abs(answer.alphas(0) - alpha_below) <= 2 * alpha_budget, "alpha");
    const Vector n = {answer.normals(0), answer.normals(1), answer.normals(2)};
    const Vector centres = b.position - a.position + rotate(b.rotation, b.contraction_point) -
                           rotate(a.rotation, a.contraction_point);
    const double reach = a.support(n) + b.support(n * -1);
    expect(std::abs(norm(n) - 1) <= 1e-15, "the normal's length");
    expect(alpha_below - dot(n, centres) / reach <= 2 * alpha_budget, "the normal is not optimal");
    const double separation = dot(n, centres) - reach;
    expect(std::abs(answer.separations(0) - separation) <= 2 * length_budget, "the separation");
    check_points(*this, answer);
}

namespace {

Side side(const json& value) {
    return {value.at("vertices"), value.at("contraction_point"), value.at("position"), value.at("rotation")};
}

}  // namespace

std::vector<Case> read_cases(const std::filesystem::path& root) {
    std::ifstream file(root / "tests/golden/contacts.json");
    const json read = json::parse(file);
    expect(read.at("format") == "hullcast.golden.v1", "the golden cases' format");
    std::vector<Case> cases;
    for (const json& value : read.at("cases")) {
        Case golden{.name = value.at("name"),
                    .a = side(value.at("a")),
                    .b = side(value.at("b")),
                    .margin = std::numeric_limits<double>::infinity(),
                    .outcome = value.at("outcome"),
                    .alpha_below = value.at("alpha_below"),
                    .alpha_above = value.at("alpha_above"),
                    .alpha_budget = value.at("alpha_budget"),
                    .length_budget = value.at("length_budget"),
                    .patch = {},
                    .patch_budget = value.at("patch_budget")};
        if (!value.at("margin").is_null()) golden.margin = value.at("margin");
        if (!value.at("patch").is_null()) golden.patch = value.at("patch").get<std::vector<Vector>>();
        cases.push_back(std::move(golden));
    }
    return cases;
}

std::vector<IdentityVector> read_identity_vectors(const std::filesystem::path& root) {
    std::ifstream file(root / "docs/identity.md");
    const std::string page{std::istreambuf_iterator<char>(file), {}};
    const std::string fence = "```json\n";
    const std::size_t start = page.find(fence) + fence.size();
    std::vector<IdentityVector> vectors;
    for (const json& value : json::parse(page.substr(start, page.find("```", start) - start))) {
        Hull hull{value.at("vertices"), value.value("contraction_point", std::vector<double>{}), {}, {}, {}};
        if (value.contains("max_vertices")) hull.max_vertices = value["max_vertices"].get<std::uint32_t>();
        if (value.contains("max_deviation")) hull.max_deviation = value["max_deviation"].get<double>();
        if (value.contains("planarity")) hull.planarity = value["planarity"].get<double>();
        vectors.push_back({value.at("name"), hull, value.at("id"), value.value("bytes", "")});
    }
    return vectors;
}
