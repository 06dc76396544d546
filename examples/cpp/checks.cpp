#include "checks.h"

#include <google/protobuf/util/message_differencer.h>

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>

namespace v1 = hullcast::v1;
using google::protobuf::util::MessageDifferencer;

int check_identities(const std::filesystem::path& root) {
    const std::vector<IdentityVector> vectors = read_identity_vectors(root);
    for (const IdentityVector& vector : vectors) {
        expect(hex(vector.hull.id()) == vector.id, vector.name + ": its id");
        expect(vector.bytes.empty() || hex(vector.hull.identity_bytes()) == vector.bytes, vector.name + ": its bytes");
    }
    return static_cast<int>(vectors.size());
}

int check_answers(Client& client, const std::vector<Case>& cases) {
    int count = 0;
    for (const Case& golden : cases) {
        client.register_hulls({golden.a.hull(), golden.b.hull()});
        for (const v1::Solver solver : {v1::SOLVER_PORTAL, v1::SOLVER_GJK_RAY_CAST}) {
            v1::QueryContactsRequest request = golden.request();
            request.mutable_accuracy()->set_solver(solver);
            try {
                golden.check(client.query(request));
            } catch (const std::exception& error) {
                throw std::runtime_error(golden.name + " with " + v1::Solver_Name(solver) + ": " + error.what());
            }
            ++count;
        }
    }
    return count;
}

namespace {

/// Asserts that the call fails with INVALID_ARGUMENT and with this reason and field.
void refused(const std::string& reason, const std::string& field, const std::function<void()>& call) {
    try {
        call();
    } catch (const Refused& error) {
        expect(error.code == grpc::StatusCode::INVALID_ARGUMENT, error.what());
        expect(error.reason == "hullcast/" + reason && error.field == field, error.reason + " " + error.field);
        return;
    }
    throw std::runtime_error(reason + " was not refused");
}

}  // namespace

int check_errors(Client& client, const Case& golden) {
    v1::QueryContactsRequest outside = golden.request();
    for (const int body : {1, 7}) outside.add_pairs(body);
    refused("INDEX_OUT_OF_RANGE", "pairs[3]", [&] { client.query(outside); });
    v1::QueryContactsRequest odd = golden.request();
    odd.mutable_rotations()->RemoveLast();
    refused("LENGTH_MISMATCH", "rotations", [&] { client.query(odd); });
    v1::QueryContactsRequest inherits;
    inherits.set_inherit(true);
    refused("NOTHING_TO_INHERIT", "inherit", [&] { client.stream({inherits}); });
    // One invalid hull does not affect the other.
    v1::RegisterHullsRequest hulls;
    *hulls.add_hulls() = definition({{0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0}, {}});
    *hulls.add_hulls() = definition(golden.a.hull());
    const v1::RegisterHullsResponse registered = client.register_hulls(hulls);
    const v1::HullError& flat = registered.results(0).error();
    expect(flat.reason() == "COPLANAR" && flat.field() == "vertices", flat.ShortDebugString());
    expect(registered.results(1).has_hull(), registered.ShortDebugString());
    // Nor does an unknown hull affect the pairs of other hulls.
    v1::QueryContactsRequest unknown = golden.request();
    const int stranger = unknown.hull_ids_size();
    unknown.add_hull_ids(std::string(32, '\0'));
    unknown.add_body_hulls(stranger);
    for (const double x : {0, 0, 0}) unknown.add_positions(x);
    for (const double x : {0, 0, 0, 1}) unknown.add_rotations(x);
    for (const int body : {0, 2}) unknown.add_pairs(body);
    const v1::QueryContactsResponse answer = client.query(unknown);
    const std::string outcomes = {v1::OUTCOME_CONTACT, v1::OUTCOME_INVALID};
    expect(answer.outcomes() == outcomes && answer.flags()[1] == v1::FLAG_UNKNOWN_HULL &&
               answer.missing_hulls_size() == 1 && answer.missing_hulls(0) == static_cast<unsigned>(stranger),
           answer.ShortDebugString());
    return 5;
}

int check_steps(Client& client, const Case& golden) {
    v1::QueryContactsRequest full = golden.request();
    full.add_outputs(v1::OUTPUT_BASES);
    std::vector<v1::QueryContactsRequest> requests = {full};
    for (int step = 1; step < 8; ++step) {
        v1::QueryContactsRequest poses;
        poses.set_request_id(step);
        poses.set_inherit(true);
        *poses.mutable_positions() = full.positions();
        poses.set_positions(3, full.positions(3) + 0.01 * step);
        *poses.mutable_rotations() = full.rotations();
        requests.push_back(poses);
    }
    const std::vector<v1::QueryContactsResponse> answers = client.stream(requests);
    for (std::size_t step = 0; step < answers.size(); ++step) {
        v1::QueryContactsRequest whole = full;
        whole.set_request_id(step);
        *whole.mutable_positions() = requests[step].positions();
        if (step > 0) *whole.mutable_warm_starts() = answers[step - 1].bases();
        expect(answers[step].alphas_size() == 1 && MessageDifferencer::Equals(answers[step], client.query(whole)),
               "step " + std::to_string(step));
    }
    return static_cast<int>(answers.size());
}

// Makes four steps in which the server finds the pairs: all bodies, none moved, one moved away, and one removed
// while a new one comes. The matches say what became of the pair of the step before.
int check_loop(Client& client, const Case& golden) {
    using Numbers = std::vector<std::uint32_t>;
    constexpr std::uint32_t none = UINT32_MAX;
    const v1::QueryContactsRequest named = golden.request();
    v1::QueryContactsRequest all = named;
    all.set_find(true);
    all.clear_pairs();
    all.add_outputs(v1::OUTPUT_MATCHES);
    v1::QueryContactsRequest still;
    still.set_inherit(true);
    v1::QueryContactsRequest moved = still;
    moved.add_moved(1);
    for (int i = 3; i < 6; ++i) moved.add_positions(named.positions(i) + (i == 3 ? 1e6 : 0));
    for (int i = 4; i < 8; ++i) moved.add_rotations(named.rotations(i));
    v1::QueryContactsRequest replaced = all;
    for (const std::uint32_t body : {0U, none}) replaced.add_previous_bodies(body);
    const std::vector<v1::QueryContactsResponse> answers = client.stream({all, still, moved, replaced});
    const auto same = [](const auto& one, const auto& other) {
        return std::equal(one.begin(), one.end(), other.begin(), other.end());
    };
    expect(same(answers[0].alphas(), client.query(named).alphas()), answers[0].ShortDebugString());
    const std::vector<std::array<Numbers, 3>> wanted = {
        {Numbers{0, 1}, Numbers{none}, Numbers{}},
        {Numbers{0, 1}, Numbers{0}, Numbers{}},
        {Numbers{}, Numbers{}, Numbers{0, 1}},
        {Numbers{0, 1}, Numbers{none}, Numbers{}},
    };
    for (std::size_t step = 0; step < wanted.size(); ++step) {
        const auto& [pairs, previous, ended] = wanted[step];
        const v1::QueryContactsResponse& answer = answers[step];
        expect(same(answer.pairs(), pairs) && same(answer.previous_pairs(), previous) &&
                   same(answer.ended_pairs(), ended),
               "step " + std::to_string(step) + ": " + answer.ShortDebugString());
    }
    return static_cast<int>(answers.size());
}

int check_deadline(Client& client, const Case& golden) {
    v1::QueryContactsRequest request = golden.request();
    for (int i = request.pairs_size(); i < 2 * 131072; ++i) request.add_pairs(i % 2);
    try {
        client.query(request, std::chrono::milliseconds(1));
    } catch (const Refused& error) {
        expect(error.code == grpc::StatusCode::DEADLINE_EXCEEDED, error.what());
        return 1;
    }
    throw std::runtime_error("a passed deadline was not noticed");
}
