package hullcast.conformance;

import java.util.List;

/** A vector of three numbers. */
record Vector(double x, double y, double z) {
  static Vector of(List<Double> numbers) {
    return new Vector(numbers.get(0), numbers.get(1), numbers.get(2));
  }

  Vector plus(Vector b) {
    return new Vector(x + b.x, y + b.y, z + b.z);
  }

  Vector minus(Vector b) {
    return new Vector(x - b.x, y - b.y, z - b.z);
  }

  Vector times(double s) {
    return new Vector(x * s, y * s, z * s);
  }

  double dot(Vector b) {
    return x * b.x + y * b.y + z * b.z;
  }

  double norm() {
    return Math.sqrt(dot(this));
  }

  Vector cross(Vector b) {
    return new Vector(y * b.z - z * b.y, z * b.x - x * b.z, x * b.y - y * b.x);
  }

  /** This vector rotated by the quaternion with vector part {@code axis}, scalar part {@code w}. */
  Vector turned(Vector axis, double w) {
    double s = 2 / (axis.dot(axis) + w * w);
    Vector turn = axis.cross(this);
    return plus(turn.times(w * s)).plus(axis.cross(turn).times(s));
  }

  /** The distance from a convex polygon in space. */
  double distanceTo(List<Vector> corners) {
    Vector first = corners.get(0);
    Vector normal = new Vector(0, 0, 0);
    for (int i = 0; i < corners.size(); i++) {
      normal = normal.plus(corners.get(i).minus(first).cross(side(corners, i)));
    }
    boolean inside = true;
    double nearest = Double.POSITIVE_INFINITY;
    for (int i = 0; i < corners.size(); i++) {
      Vector side = side(corners, i);
      Vector to = minus(corners.get(i));
      inside &= normal.cross(side).dot(to) >= 0;
      double t = Math.max(0, Math.min(1, to.dot(side) / side.dot(side)));
      nearest = Math.min(nearest, to.minus(side.times(t)).norm());
    }
    return inside ? Math.abs(minus(first).dot(normal)) / normal.norm() : nearest;
  }

  private static Vector side(List<Vector> corners, int i) {
    return corners.get((i + 1) % corners.size()).minus(corners.get(i));
  }
}
