package hullcast.conformance;

import static hullcast.conformance.Checks.expect;

import io.grpc.CallCredentials;
import io.grpc.ChannelCredentials;
import io.grpc.Metadata;
import io.grpc.Status;
import io.grpc.StatusRuntimeException;
import io.grpc.TlsChannelCredentials;
import java.io.File;
import java.util.List;
import java.util.concurrent.Executor;

/** Checks calls to a server with TLS and tokens. */
final class Secured {
  /** A bearer token to send with every call. */
  private static final class Token extends CallCredentials {
    private static final Metadata.Key<String> KEY =
        Metadata.Key.of("authorization", Metadata.ASCII_STRING_MARSHALLER);
    private final String token;

    Token(String token) {
      this.token = token;
    }

    @Override
    public void applyRequestMetadata(RequestInfo info, Executor executor, MetadataApplier applier) {
      Metadata headers = new Metadata();
      headers.put(KEY, "Bearer " + token);
      applier.apply(headers);
    }
  }

  private record Attempt(ChannelCredentials credentials, CallCredentials token, Status.Code code) {}

  private Secured() {}

  /**
   * Calls the server. The client must trust its authority and send a token, and the token's role
   * must allow the call.
   *
   * @param arguments the target, the authority's certificate, a token that may register and a token
   *     that may query; or empty, to skip the check
   */
  static int check(List<String> arguments, Case golden) throws Exception {
    if (arguments.isEmpty()) {
      return 0;
    }
    String target = arguments.get(0);
    ChannelCredentials trusting =
        TlsChannelCredentials.newBuilder().trustManager(new File(arguments.get(1))).build();
    Token registers = new Token(arguments.get(2));
    Token queries = new Token(arguments.get(3));
    List<Attempt> attempts =
        List.of(
            new Attempt(TlsChannelCredentials.create(), null, Status.Code.UNAVAILABLE),
            new Attempt(trusting, null, Status.Code.UNAUTHENTICATED),
            new Attempt(trusting, new Token("none"), Status.Code.UNAUTHENTICATED),
            new Attempt(trusting, queries, Status.Code.PERMISSION_DENIED),
            new Attempt(trusting, registers, Status.Code.OK));
    for (Attempt attempt : attempts) {
      Status.Code code = Status.Code.OK;
      try (Client client = new Client(target, attempt.credentials, attempt.token)) {
        client.register(golden.a().hull());
      } catch (StatusRuntimeException e) {
        code = e.getStatus().getCode();
      }
      expect(code == attempt.code, "%s, not %s", code, attempt.code);
    }
    try (Client client = new Client(target, trusting, queries)) {
      golden.check(Checks.query(client, golden.request()));
    }
    return attempts.size() + 1;
  }
}
