#pragma once

#include "client.h"
#include "golden.h"

// The checks. Each returns the number of things that it checked, and throws if one is wrong.

int check_identities(const std::filesystem::path& root);
/// Queries every case with both solvers.
int check_answers(Client& client, const std::vector<Case>& cases);
int check_errors(Client& client, const Case& golden);
/// Sends only poses after a stream's first message. Each answer must equal that of the full request
/// with the previous bases as warm starts.
int check_steps(Client& client, const Case& golden);
int check_loop(Client& client, const Case& golden);
/// Sends a request that takes many times its deadline.
int check_deadline(Client& client, const Case& golden);
/// Calls a server with TLS and tokens. The client must trust its authority and send a token, and
/// the token's role must allow the call. `arguments` are the target, the authority's certificate, a
/// token that may register and a token that may query; or empty, to skip the check.
int check_secured(const std::vector<std::string>& arguments, const Case& golden);
