#include <grpcpp/grpcpp.h>

#include <cstdio>

#include "hullcast/v1/contacts.grpc.pb.h"
#include "hullcast/v1/hulls.grpc.pb.h"

int main(int, char** argv) {
    const auto channel = grpc::CreateChannel(argv[1], grpc::InsecureChannelCredentials());
    grpc::ClientContext registering, querying;
    hullcast::v1::RegisterHullsRequest hulls;
    auto& cube = *hulls.add_hulls()->mutable_vertices();
    for (double v : {0, 0, 0, 0, 0, 1, 0, 1, 0, 0, 1, 1, 1, 0, 0, 1, 0, 1, 1, 1, 0, 1, 1, 1}) cube.Add(v);
    hullcast::v1::RegisterHullsResponse registered;
    auto status = hullcast::v1::HullService::NewStub(channel)->RegisterHulls(&registering, hulls, &registered);
    if (!status.ok()) return std::fprintf(stderr, "%s\n", status.error_message().c_str()), 1;

    hullcast::v1::QueryContactsRequest scene;
    scene.add_hull_ids(registered.results(0).hull().id());
    for (int hull : {0, 0}) scene.add_body_hulls(hull);  // both bodies are the cube
    for (double p : {0.0, 0.0, 0.0, 0.2, 0.0, 0.99}) scene.add_positions(p);
    for (double q : {0, 0, 0, 1, 0, 0, 0, 1}) scene.add_rotations(q);
    for (int body : {0, 1}) scene.add_pairs(body);
    scene.set_margin(0.01);
    hullcast::v1::QueryContactsResponse m;
    status = hullcast::v1::ContactService::NewStub(channel)->QueryContacts(&querying, scene, &m);
    if (!status.ok()) return std::fprintf(stderr, "%s\n", status.error_message().c_str()), 1;
    std::printf("alpha %.2f, separation %.2f, %u points\n", m.alphas(0), m.separations(0), m.point_counts(0));
}
