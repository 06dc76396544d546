import assert from "node:assert/strict";
import { fileURLToPath } from "node:url";

import * as grpc from "@grpc/grpc-js";
import { loadSync } from "@grpc/proto-loader";

import type { ProtoGrpcType as Contacts } from "./generated/contacts.js";
import type { ProtoGrpcType as Details } from "./generated/details.js";
import type { ProtoGrpcType as Hulls } from "./generated/hulls.js";
import type { QueryContactsRequest } from "./generated/hullcast/v1/QueryContactsRequest.js";
import type { QueryContactsResponse__Output as Answer } from "./generated/hullcast/v1/QueryContactsResponse.js";
import type { RegisterHullsRequest } from "./generated/hullcast/v1/RegisterHullsRequest.js";
import type { RegisterHullsResponse__Output } from "./generated/hullcast/v1/RegisterHullsResponse.js";
import { type Hull, hullId } from "./identity.js";

const directory = (path: string) => fileURLToPath(new URL(path, import.meta.url));
// These options must match those with which the types were generated (package.json).
const definitions = loadSync(
  ["hullcast/v1/hulls.proto", "hullcast/v1/contacts.proto", "google/rpc/details.proto"],
  { includeDirs: ["../../../proto", "../../proto"].map(directory), longs: Number, defaults: true, oneofs: true },
);
const contract = grpc.loadPackageDefinition(definitions) as unknown as Hulls & Contacts & Details;
const { v1 } = contract.hullcast;
const { rpc } = contract.google;

/** The server's default message limit in both directions. gRPC's own default is 4 MiB. */
const MAX_MESSAGE_BYTES = 64 << 20;

/** The hull service and the contact service. */
export class Client {
  readonly #hulls;
  readonly #contacts;

  constructor(target: string, credentials = grpc.credentials.createInsecure()) {
    const options = {
      "grpc.max_receive_message_length": MAX_MESSAGE_BYTES,
      "grpc.max_send_message_length": MAX_MESSAGE_BYTES,
    };
    this.#hulls = new v1.HullService(target, credentials, options);
    this.#contacts = new v1.ContactService(target, credentials, options);
  }

  close(): void {
    this.#hulls.close();
    this.#contacts.close();
  }

  registerHulls(request: RegisterHullsRequest): Promise<RegisterHullsResponse__Output> {
    return promised((callback) => this.#hulls.registerHulls(request, callback));
  }

  /** Registers hulls and returns their ids, after comparing them with those computed here. */
  async register(...hulls: Hull[]): Promise<Buffer[]> {
    const { results } = await this.registerHulls({ hulls });
    return results.map((result, i) => {
      assert.ok(result.hull, `hull ${i}: ${result.error?.reason}: ${result.error?.message}`);
      assert.ok(result.hull.id.equals(hullId(hulls[i]!)), `hull ${i}: the server's id is another`);
      return result.hull.id;
    });
  }

  query(request: QueryContactsRequest, options: grpc.CallOptions = {}): Promise<Answer> {
    return promised((callback) => this.#contacts.queryContacts(request, options, callback));
  }

  /** Sends each request after the answer to the previous one. */
  async stream(requests: QueryContactsRequest[]): Promise<Answer[]> {
    const call = this.#contacts.streamContacts();
    const received: AsyncIterator<Answer> = call[Symbol.asyncIterator]();
    const answers: Answer[] = [];
    for (const request of requests) {
      call.write(request);
      const { done, value } = await received.next();
      assert.ok(!done, "the stream ended early");
      answers.push(value);
    }
    call.end();
    assert.ok((await received.next()).done, "more answers than requests");
    return answers;
  }
}

function promised<T>(call: (callback: grpc.requestCallback<T>) => void): Promise<T> {
  return new Promise((resolve, reject) => call((error, value) => (error ? reject(error) : resolve(value!))));
}

/** Describes an error by its code, reason and field. */
export function refusal(error: unknown): string {
  const { code, metadata } = error as grpc.ServiceError;
  let [reason, field] = ["", ""];
  for (const trailer of metadata.get("grpc-status-details-bin")) {
    for (const detail of rpc.Status.deserialize(trailer as Buffer).details) {
      if (detail.type_url.endsWith("/google.rpc.ErrorInfo")) {
        const info = rpc.ErrorInfo.deserialize(detail.value);
        reason = `${info.domain}/${info.reason}`;
      } else if (detail.type_url.endsWith("/google.rpc.BadRequest")) {
        field = rpc.BadRequest.deserialize(detail.value).fieldViolations[0]!.field;
      }
    }
  }
  return `${grpc.status[code]} ${reason} ${field}`;
}
