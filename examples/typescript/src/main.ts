// Tests a server, and the generated code for TypeScript, against the golden cases and the
// documented errors. Prints the number of checks of each kind.
//
//   node out/main.js ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]
import assert from "node:assert/strict";

import { answers, deadlines, errors, identities, loops, secured, steps } from "./checks.js";
import { Client } from "./client.js";
import { readCases } from "./golden.js";

const [root, target, ...secure] = process.argv.slice(2);
assert.ok(root && target, "main.js ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]");
const cases = readCases(root);
const client = new Client(target);
console.log("identities", identities(root));
console.log("answers", await answers(client, cases));
console.log("errors", await errors(client, cases[0]!));
console.log("steps", await steps(client, cases[0]!));
console.log("loops", await loops(client, cases[0]!));
console.log("deadlines", await deadlines(client, cases[0]!));
console.log("secured", await secured(secure, cases[0]!));
client.close();
