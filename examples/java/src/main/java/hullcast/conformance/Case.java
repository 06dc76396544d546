package hullcast.conformance;

import static hullcast.conformance.Checks.expect;

import com.google.gson.annotations.SerializedName;
import com.google.protobuf.ByteString;
import hullcast.v1.Contacts.Flag;
import hullcast.v1.Contacts.Outcome;
import hullcast.v1.Contacts.Output;
import hullcast.v1.Contacts.QueryContactsRequest;
import hullcast.v1.Contacts.QueryContactsResponse;
import java.util.ArrayList;
import java.util.List;
import java.util.stream.DoubleStream;
import java.util.stream.Stream;

/** A case of tests/golden/contacts.json, which tests/golden/README.md describes. */
record Case(
    String name,
    Side a,
    Side b,
    Double margin,
    String outcome,
    @SerializedName("alpha_below") double alphaBelow,
    @SerializedName("alpha_above") double alphaAbove,
    @SerializedName("alpha_budget") double alphaBudget,
    @SerializedName("length_budget") double lengthBudget,
    double[][] patch,
    @SerializedName("patch_budget") double patchBudget) {

  /** The request for the case's scene and its one pair. */
  QueryContactsRequest.Builder request() {
    ByteString first = a.hull().id();
    ByteString second = b.hull().id();
    QueryContactsRequest.Builder request = QueryContactsRequest.newBuilder();
    request.addHullIds(first).addBodyHulls(0);
    if (!second.equals(first)) { // each hull is listed once
      request.addHullIds(second);
    }
    request.addBodyHulls(request.getHullIdsCount() - 1);
    for (Side side : List.of(a, b)) {
      DoubleStream.of(side.position()).forEach(request::addPositions);
      DoubleStream.of(side.rotation()).forEach(request::addRotations);
    }
    return request
        .addAllPairs(List.of(0, 1))
        .setMargin(margin == null ? Double.POSITIVE_INFINITY : margin)
        .addAllOutputs(List.of(Output.OUTPUT_ALPHA, Output.OUTPUT_NORMAL, Output.OUTPUT_POINTS));
  }

  /** Compares the answer for the case's one pair with the exact one. */
  void check(QueryContactsResponse answer) {
    Outcome found = Outcome.forNumber(answer.getOutcomes().byteAt(0));
    expect(found == Outcome.valueOf("OUTCOME_" + outcome), "outcome %s", found);
    double alpha = answer.getAlphas(0);
    double lower = answer.getAlphaLowers(0);
    double upper = answer.getAlphaUppers(0);
    expect(lower <= alphaBelow && upper >= alphaAbove, "alpha is not in [%s, %s]", lower, upper);
    if (found == Outcome.OUTCOME_SEPARATED) {
      return;
    }
    // Twice the budgets, because the numbers computed here are rounded too.
    expect(Math.abs(alpha - alphaBelow) <= 2 * alphaBudget, "alpha %s, not %s", alpha, alphaBelow);
    Vector n = Vector.of(answer.getNormalsList());
    Vector centres = b.place().minus(a.place()).plus(b.arm()).minus(a.arm());
    double reach = a.support(n) + b.support(n.times(-1));
    expect(Math.abs(n.norm() - 1) <= 1e-15, "a normal of length %s", n.norm());
    expect(alphaBelow - n.dot(centres) / reach <= 2 * alphaBudget, "%s is not optimal", n);
    double off = answer.getSeparations(0) - (n.dot(centres) - reach);
    expect(Math.abs(off) <= 2 * lengthBudget, "the separation is off by %s", off);
    checkPoints(answer);
  }

  private void checkPoints(QueryContactsResponse answer) {
    int count = answer.getPointCounts(0);
    expect(count > 0 && answer.getDistancesCount() == count, "%s points", count);
    expect(answer.getWitnessAsCount() == 3 * count, "%s numbers", answer.getWitnessAsCount());
    if (patch == null) {
      return;
    }
    expect(count >= 3 && (answer.getFlags().byteAt(0) & Flag.FLAG_ESTIMATED_VALUE) == 0, "no patch");
    List<Vector> found = new ArrayList<>();
    for (int i = 0; i < count; i++) {
      found.add(Vector.of(answer.getWitnessAsList().subList(3 * i, 3 * i + 3)));
    }
    List<Vector> exact = Stream.of(patch).map(p -> new Vector(p[0], p[1], p[2])).toList();
    DoubleStream there = found.stream().mapToDouble(p -> p.distanceTo(exact));
    DoubleStream back = exact.stream().mapToDouble(p -> p.distanceTo(found));
    double far = DoubleStream.concat(there, back).max().orElseThrow();
    expect(far <= patchBudget, "the patch is %s from the exact one", far);
  }
}
