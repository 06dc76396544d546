// Tests a server, and the generated code for C++, against the golden cases and the documented
// errors. Prints the number of checks of each kind.
//
//     conformance ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]

#include <iostream>

#include "checks.h"

int main(int argc, char** argv) {
    const std::vector<std::string> arguments(argv + 1, argv + argc);
    if (arguments.size() != 2 && arguments.size() != 6) {
        std::cerr << "conformance ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]\n";
        return 2;
    }
    try {
        const std::vector<Case> cases = read_cases(arguments[0]);
        Client client(arguments[1], grpc::InsecureChannelCredentials());
        std::cout << "identities " << check_identities(arguments[0]) << std::endl;
        std::cout << "answers " << check_answers(client, cases) << std::endl;
        std::cout << "errors " << check_errors(client, cases.at(0)) << std::endl;
        std::cout << "steps " << check_steps(client, cases.at(0)) << std::endl;
        std::cout << "loops " << check_loop(client, cases.at(0)) << std::endl;
        std::cout << "deadlines " << check_deadline(client, cases.at(0)) << std::endl;
        std::cout << "secured " << check_secured({arguments.begin() + 2, arguments.end()}, cases.at(0)) << std::endl;
    } catch (const std::exception& error) {
        std::cerr << "conformance: " << error.what() << std::endl;
        return 1;
    }
}
