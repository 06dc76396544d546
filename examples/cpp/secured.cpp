#include <fstream>
#include <iterator>

#include "checks.h"

using Credentials = std::shared_ptr<grpc::ChannelCredentials>;

int check_secured(const std::vector<std::string>& arguments, const Case& golden) {
    if (arguments.empty()) return 0;
    const std::string &target = arguments.at(0), &registers = arguments.at(2), &queries = arguments.at(3);
    std::ifstream file(arguments.at(1));
    const std::string authority{std::istreambuf_iterator<char>(file), {}};
    const Credentials tls = grpc::SslCredentials({.pem_root_certs = authority, .pem_private_key = {}, .pem_cert_chain = {}});
    const auto sending = [&](const std::string& token) -> Credentials {
        return grpc::CompositeChannelCredentials(tls, grpc::AccessTokenCredentials(token));
    };
    const struct {
        Credentials credentials;
        grpc::StatusCode code;
    } attempts[] = {
        {grpc::SslCredentials({}), grpc::StatusCode::UNAVAILABLE},
        {tls, grpc::StatusCode::UNAUTHENTICATED},
        {sending("none"), grpc::StatusCode::UNAUTHENTICATED},
        {sending(queries), grpc::StatusCode::PERMISSION_DENIED},
        {sending(registers), grpc::StatusCode::OK},
    };
    int count = 0;
    for (const auto& [credentials, wanted] : attempts) {
        grpc::StatusCode code = grpc::StatusCode::OK;
        try {
            Client(target, credentials).register_hulls({golden.a.hull()});
        } catch (const Refused& error) {
            code = error.code;
        }
        expect(code == wanted, "attempt " + std::to_string(count) + ": code " + std::to_string(code));
        ++count;
    }
    golden.check(Client(target, sending(queries)).query(golden.request()));
    return count + 1;
}
