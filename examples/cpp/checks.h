#pragma once

#include "client.h"
#include "golden.h"

// What is checked; each says how many it checked, and throws where something is otherwise.

int check_identities(const std::filesystem::path& root);
/// Every case with either solver.
int check_answers(Client& client, const std::vector<Case>& cases);
int check_errors(Client& client, const Case& golden);
/// Poses alone after a stream's first message: each answer is that of the request in full, warm
/// from the bases before.
int check_steps(Client& client, const Case& golden);
/// A request that takes many times its deadline.
int check_deadline(Client& client, const Case& golden);
/// A server with TLS and tokens: its authority has to be trusted, a token sent, and the token's
/// role has to allow the call. `arguments`: its target, the authority's certificate, tokens that
/// may register and query; or none.
int check_secured(const std::vector<std::string>& arguments, const Case& golden);
