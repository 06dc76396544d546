package hullcast.conformance;

import com.google.gson.annotations.SerializedName;
import java.util.Arrays;
import java.util.stream.Stream;

/**
 * A hull at its pose, as tests/golden/README.md describes it.
 *
 * @param rotation x, y, z, w
 */
record Side(
    double[][] vertices,
    @SerializedName("contraction_point") double[] contractionPoint,
    double[] position,
    double[] rotation) {
  Hull hull() {
    return new Hull(Stream.of(vertices).flatMapToDouble(Arrays::stream).toArray(), contractionPoint);
  }

  private static Vector vector(double[] numbers) {
    return new Vector(numbers[0], numbers[1], numbers[2]);
  }

  /** From the world's origin to the hull frame's. */
  Vector place() {
    return vector(position);
  }

  /** From the hull frame's origin to the contraction point, in the world. */
  Vector arm() {
    return vector(contractionPoint).turned(vector(rotation), rotation[3]);
  }

  /** Largest n . (v - contraction point), n in the world. */
  double support(Vector n) {
    Vector local = n.turned(vector(rotation).times(-1), rotation[3]);
    Vector center = vector(contractionPoint);
    return Stream.of(vertices).mapToDouble(v -> local.dot(vector(v).minus(center))).max().orElseThrow();
  }
}
