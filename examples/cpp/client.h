#pragma once

#include <grpcpp/grpcpp.h>

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "hull.h"
#include "hullcast/v1/contacts.grpc.pb.h"
#include "hullcast/v1/hulls.grpc.pb.h"

/// The hull service and the contact service. A call that fails throws `Refused`.
class Client {
public:
    Client(const std::string& target, const std::shared_ptr<grpc::ChannelCredentials>& credentials);

    hullcast::v1::RegisterHullsResponse register_hulls(const hullcast::v1::RegisterHullsRequest& request);
    /// Registers hulls, and compares the server's ids with those computed here.
    void register_hulls(const std::vector<Hull>& hulls);
    hullcast::v1::QueryContactsResponse query(
        const hullcast::v1::QueryContactsRequest& request,
        std::chrono::milliseconds timeout = std::chrono::seconds(60));
    /// Sends each request after the answer to the previous one.
    std::vector<hullcast::v1::QueryContactsResponse> stream(
        const std::vector<hullcast::v1::QueryContactsRequest>& requests);

private:
    std::unique_ptr<hullcast::v1::HullService::Stub> hulls_;
    std::unique_ptr<hullcast::v1::ContactService::Stub> contacts_;
};

hullcast::v1::HullDefinition definition(const Hull& hull);

/// A call that failed, with the details of its error.
struct Refused : std::runtime_error {
    explicit Refused(const grpc::Status& status);

    grpc::StatusCode code;
    /// Domain and reason of the ErrorInfo; empty without an ErrorInfo.
    std::string reason;
    /// The field of the BadRequest; empty without a BadRequest.
    std::string field;
};
