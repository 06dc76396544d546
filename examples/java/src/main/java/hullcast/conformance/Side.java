package hullcast.conformance;

import com.google.gson.annotations.SerializedName;
import java.util.Arrays;
import java.util.stream.Stream;

/**
 * A hull at a pose, as tests/golden/README.md describes it.
 *
 * @param rotation a quaternion in the order x, y, z, w
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

  /** The vector from the world's origin to the origin of the hull's frame. */
  Vector place() {
    return vector(position);
  }

  /** The vector from the origin of the hull's frame to the contraction point, world axes. */
  Vector arm() {
    return vector(contractionPoint).turned(vector(rotation), rotation[3]);
  }

  /** The largest n . (v - contraction point) over the vertices v; n is in the world frame. */
  double support(Vector n) {
    Vector local = n.turned(vector(rotation).times(-1), rotation[3]);
    Vector centre = vector(contractionPoint);
    return Stream.of(vertices).mapToDouble(v -> local.dot(vector(v).minus(centre))).max().orElseThrow();
  }
}
