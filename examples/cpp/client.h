#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "hull.h"
#include "hullcast/v1/contacts.grpc.pb.h"
#include "hullcast/v1/hulls.grpc.pb.h"

/// The two services that matter. A call that fails throws `Refused`.
class Client {
public:
    Client(const std::string& target, const std::shared_ptr<grpc::ChannelCredentials>& credentials);

    hullcast::v1::RegisterHullsResponse register_hulls(const hullcast::v1::RegisterHullsRequest& request);
    /// Compares the ids with those computed here.
    void register_hulls(const std::vector<Hull>& hulls);
    hullcast::v1::QueryContactsResponse query(
        const hullcast::v1::QueryContactsRequest& request,
        std::chrono::milliseconds timeout = std::chrono::seconds(60));
    /// Sends each request after the answer to the one before.
    std::vector<hullcast::v1::QueryContactsResponse> stream(
        const std::vector<hullcast::v1::QueryContactsRequest>& requests);

private:
    std::unique_ptr<hullcast::v1::HullService::Stub> hulls_;
    std::unique_ptr<hullcast::v1::ContactService::Stub> contacts_;
};

hullcast::v1::HullDefinition definition(const Hull& hull);

/// A call that failed, and what the error says of itself.
struct Refused : std::runtime_error {
    explicit Refused(const grpc::Status& status);

    grpc::StatusCode code;
    /// Domain and reason of the ErrorInfo; empty without one.
    std::string reason;
    /// Of the BadRequest; empty without one.
    std::string field;
};
