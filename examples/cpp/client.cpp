#include "client.h"

#include "golden.h"
#include "google/rpc/details.pb.h"

namespace v1 = hullcast::v1;

namespace {

/// The server's default message limit in both directions. gRPC's own default is 4 MiB.
constexpr int MAX_MESSAGE_BYTES = 64 << 20;

void succeeded(const grpc::Status& status) {
    if (!status.ok()) throw Refused(status);
}

}  // namespace

Client::Client(const std::string& target, const std::shared_ptr<grpc::ChannelCredentials>& credentials) {
    grpc::ChannelArguments arguments;
    arguments.SetMaxReceiveMessageSize(MAX_MESSAGE_BYTES);
    arguments.SetMaxSendMessageSize(MAX_MESSAGE_BYTES);
    const auto channel = grpc::CreateCustomChannel(target, credentials, arguments);
    hulls_ = v1::HullService::NewStub(channel);
    contacts_ = v1::ContactService::NewStub(channel);
}

v1::RegisterHullsResponse Client::register_hulls(const v1::RegisterHullsRequest& request) {
    grpc::ClientContext context;
    v1::RegisterHullsResponse response;
    succeeded(hulls_->RegisterHulls(&context, request, &response));
    return response;
}

void Client::register_hulls(const std::vector<Hull>& hulls) {
    v1::RegisterHullsRequest request;
    for (const Hull& hull : hulls) *request.add_hulls() = definition(hull);
    const v1::RegisterHullsResponse response = register_hulls(request);
    for (std::size_t i = 0; i < hulls.size(); ++i) {
        const v1::RegisterHullResult& result = response.results(static_cast<int>(i));
        expect(result.has_hull(), result.error().reason() + ": " + result.error().message());
        expect(result.hull().id() == hulls[i].id(), "the server's id is " + hex(result.hull().id()));
    }
}

v1::QueryContactsResponse Client::query(const v1::QueryContactsRequest& request,
                                        std::chrono::milliseconds timeout) {
    grpc::ClientContext context;
    context.set_deadline(std::chrono::system_clock::now() + timeout);
    v1::QueryContactsResponse response;
    succeeded(contacts_->QueryContacts(&context, request, &response));
    return response;
}

std::vector<v1::QueryContactsResponse> Client::stream(const std::vector<v1::QueryContactsRequest>& requests) {
    grpc::ClientContext context;
    const auto call = contacts_->StreamContacts(&context);
    std::vector<v1::QueryContactsResponse> answers;
    for (const v1::QueryContactsRequest& request : requests) {
        call->Write(request);
        if (v1::QueryContactsResponse answer; call->Read(&answer)) {
            answers.push_back(std::move(answer));
        } else {
            break;
        }
    }
    call->WritesDone();
    succeeded(call->Finish());
    expect(answers.size() == requests.size(), std::to_string(answers.size()) + " answers");
    return answers;
}

v1::HullDefinition definition(const Hull& hull) {
    v1::HullDefinition message;
    message.mutable_vertices()->Add(hull.vertices.begin(), hull.vertices.end());
    message.mutable_contraction_point()->Add(hull.contraction_point.begin(), hull.contraction_point.end());
    if (hull.max_vertices) message.mutable_simplification()->set_max_vertices(*hull.max_vertices);
    if (hull.max_deviation) message.mutable_simplification()->set_max_deviation(*hull.max_deviation);
    if (hull.planarity) message.set_planarity(*hull.planarity);
    return message;
}

Refused::Refused(const grpc::Status& status)
    : std::runtime_error(status.error_message()), code(status.error_code()) {
    google::rpc::Status said;
    said.ParseFromString(status.error_details());
    for (const google::protobuf::Any& detail : said.details()) {
        google::rpc::ErrorInfo info;
        google::rpc::BadRequest request;
        if (detail.UnpackTo(&info)) {
            reason = info.domain() + "/" + info.reason();
        } else if (detail.UnpackTo(&request)) {
            field = request.field_violations(0).field();
        }
    }
}
