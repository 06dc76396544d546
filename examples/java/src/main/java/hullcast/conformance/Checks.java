package hullcast.conformance;

import com.google.protobuf.ByteString;
import hullcast.v1.Contacts.Accuracy;
import hullcast.v1.Contacts.Flag;
import hullcast.v1.Contacts.Outcome;
import hullcast.v1.Contacts.Output;
import hullcast.v1.Contacts.QueryContactsRequest;
import hullcast.v1.Contacts.QueryContactsResponse;
import hullcast.v1.Contacts.Solver;
import hullcast.v1.Hulls.HullDefinition;
import hullcast.v1.Hulls.HullError;
import hullcast.v1.Hulls.RegisterHullsRequest;
import hullcast.v1.Hulls.RegisterHullsResponse;
import io.grpc.Status;
import io.grpc.StatusException;
import io.grpc.StatusRuntimeException;
import java.io.IOException;
import java.nio.file.Path;
import java.util.ArrayList;
import java.util.Collections;
import java.util.HexFormat;
import java.util.List;
import java.util.concurrent.Callable;
import java.util.concurrent.TimeUnit;

/** The checks. Each returns the number of things that it checked. */
final class Checks {
  private Checks() {}

  static void expect(boolean holds, String otherwise, Object... values) {
    if (!holds) {
      throw new AssertionError(otherwise.formatted(values));
    }
  }

  static int identities(Path root) throws IOException {
    HexFormat hex = HexFormat.of();
    List<Golden.IdentityVector> vectors = Golden.identityVectors(root);
    for (Golden.IdentityVector vector : vectors) {
      String id = hex.formatHex(vector.hull().id().toByteArray());
      expect(id.equals(vector.id()), "%s: %s", vector.name(), id);
      String bytes = hex.formatHex(vector.hull().identityBytes());
      expect(vector.bytes() == null || bytes.equals(vector.bytes()), "%s: %s", vector.name(), bytes);
    }
    return vectors.size();
  }

  /** Queries every case with both solvers. */
  static int answers(Client client, List<Case> cases) {
    int count = 0;
    for (Case golden : cases) {
      client.register(golden.a().hull(), golden.b().hull());
      for (Solver solver : List.of(Solver.SOLVER_PORTAL, Solver.SOLVER_GJK_RAY_CAST)) {
        try {
          Accuracy accuracy = Accuracy.newBuilder().setSolver(solver).build();
          golden.check(query(client, golden.request().setAccuracy(accuracy)));
        } catch (AssertionError | Exception e) {
          throw new AssertionError(golden.name() + " with " + solver, e);
        }
        count++;
      }
    }
    return count;
  }

  static QueryContactsResponse query(Client client, QueryContactsRequest.Builder request)
      throws Exception {
    return client.contacts.queryContacts(request.build());
  }

  /** Asserts that the call fails, with this code, reason and field. */
  static void refused(String wanted, Callable<?> call) throws Exception {
    String said = "no error";
    try {
      call.call();
    } catch (StatusException | StatusRuntimeException e) {
      said = Client.refusal(e);
    }
    expect(said.equals(wanted), "%s, not %s", said, wanted);
  }

  static int errors(Client client, Case golden) throws Exception {
    QueryContactsRequest.Builder outside = golden.request().addAllPairs(List.of(1, 7));
    refused("INVALID_ARGUMENT hullcast/INDEX_OUT_OF_RANGE pairs[3]", () -> query(client, outside));
    QueryContactsRequest.Builder turns = golden.request();
    QueryContactsRequest.Builder odd =
        turns.clone().clearRotations().addAllRotations(turns.getRotationsList().subList(1, 8));
    refused("INVALID_ARGUMENT hullcast/LENGTH_MISMATCH rotations", () -> query(client, odd));
    QueryContactsRequest inherits = QueryContactsRequest.newBuilder().setInherit(true).build();
    refused(
        "INVALID_ARGUMENT hullcast/NOTHING_TO_INHERIT inherit",
        () -> client.stream(List.of(inherits)));
    // One invalid hull does not affect the other.
    double[] corners = {0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0};
    HullDefinition flat = new Hull(corners, new double[0]).definition();
    HullDefinition good = golden.a().hull().definition();
    RegisterHullsResponse registered =
        client.hulls.registerHulls(RegisterHullsRequest.newBuilder().addHulls(flat).addHulls(good).build());
    HullError error = registered.getResults(0).getError();
    expect(error.getReason().equals("COPLANAR") && error.getField().equals("vertices"), "%s", error);
    expect(registered.getResults(1).hasHull(), "%s", registered);
    // Nor does an unknown hull affect the pairs of other hulls.
    QueryContactsRequest.Builder unknown = golden.request();
    int stranger = unknown.getHullIdsCount();
    unknown.addHullIds(ByteString.copyFrom(new byte[32])).addBodyHulls(stranger);
    unknown.addAllPositions(List.of(0.0, 0.0, 0.0)).addAllRotations(List.of(0.0, 0.0, 0.0, 1.0));
    QueryContactsResponse answer = query(client, unknown.addAllPairs(List.of(0, 2)));
    byte[] outcomes = {Outcome.OUTCOME_CONTACT_VALUE, Outcome.OUTCOME_INVALID_VALUE};
    expect(answer.getOutcomes().equals(ByteString.copyFrom(outcomes)), "%s", answer);
    expect(answer.getFlags().byteAt(1) == Flag.FLAG_UNKNOWN_HULL_VALUE, "%s", answer);
    expect(answer.getMissingHullsList().equals(List.of(stranger)), "%s", answer);
    return 5;
  }

  /**
   * Sends only poses after a stream's first message. Each answer must equal that of the full
   * request with the previous bases as warm starts.
   */
  static int steps(Client client, Case golden) throws Exception {
    QueryContactsRequest full = golden.request().addOutputs(Output.OUTPUT_BASES).build();
    List<QueryContactsRequest> requests = new ArrayList<>(List.of(full));
    for (int step = 1; step < 8; step++) {
      requests.add(
          QueryContactsRequest.newBuilder()
              .setRequestId(step)
              .setInherit(true)
              .addAllPositions(full.getPositionsList())
              .setPositions(3, full.getPositions(3) + 0.01 * step)
              .addAllRotations(full.getRotationsList())
              .build());
    }
    List<QueryContactsResponse> answers = client.stream(requests);
    for (int step = 0; step < answers.size(); step++) {
      QueryContactsRequest.Builder whole = full.toBuilder().setRequestId(step).clearPositions();
      whole.addAllPositions(requests.get(step).getPositionsList());
      if (step > 0) {
        whole.addAllWarmStarts(answers.get(step - 1).getBasesList());
      }
      QueryContactsResponse answer = answers.get(step);
      expect(answer.getAlphasCount() == 1 && answer.equals(query(client, whole)), "step %s", step);
    }
    return answers.size();
  }

  /**
   * Makes four steps in which the server finds the pairs: all bodies, none moved, one moved away,
   * and one removed while a new one comes. The matches say what became of the pair of the step
   * before.
   */
  static int loops(Client client, Case golden) throws Exception {
    QueryContactsRequest named = golden.request().build();
    QueryContactsRequest all =
        named.toBuilder().setFind(true).clearPairs().addOutputs(Output.OUTPUT_MATCHES).build();
    List<QueryContactsResponse> answers =
        client.stream(
            List.of(
                all,
                QueryContactsRequest.newBuilder().setInherit(true).build(),
                QueryContactsRequest.newBuilder()
                    .setInherit(true)
                    .addMoved(1)
                    .addAllPositions(named.getPositionsList().subList(3, 6))
                    .setPositions(0, named.getPositions(3) + 1e6)
                    .addAllRotations(named.getRotationsList().subList(4, 8))
                    .build(),
                // -1 has the bits of 2^32 - 1, which stands for a new body.
                all.toBuilder().addAllPreviousBodies(List.of(0, -1)).build()));
    List<Double> alphas = query(client, named.toBuilder()).getAlphasList();
    expect(answers.get(0).getAlphasList().equals(alphas), "the found pair: %s", answers.get(0));
    List<List<List<Integer>>> wanted =
        List.of(
            List.of(List.of(0, 1), List.of(-1), List.of()),
            List.of(List.of(0, 1), List.of(0), List.of()),
            List.of(List.of(), List.of(), List.of(0, 1)),
            List.of(List.of(0, 1), List.of(-1), List.of()));
    for (int step = 0; step < wanted.size(); step++) {
      QueryContactsResponse answer = answers.get(step);
      List<List<Integer>> found =
          List.of(answer.getPairsList(), answer.getPreviousPairsList(), answer.getEndedPairsList());
      expect(found.equals(wanted.get(step)), "step %s: %s", step, found);
    }
    return answers.size();
  }

  /** Sends a request that takes many times its deadline. */
  static int deadlines(Client client, Case golden) throws Exception {
    QueryContactsRequest.Builder request = golden.request();
    Collections.nCopies(131072 - 1, List.of(0, 1)).forEach(request::addAllPairs);
    QueryContactsRequest slow = request.build();
    Status.Code code = Status.Code.OK;
    try {
      client.contacts.withDeadlineAfter(1, TimeUnit.MILLISECONDS).queryContacts(slow);
    } catch (StatusException e) {
      code = e.getStatus().getCode();
    }
    expect(code == Status.Code.DEADLINE_EXCEEDED, "a passed deadline: %s", code);
    return 1;
  }
}
