package hullcast.conformance;

import com.google.protobuf.ByteString;
import hullcast.v1.Hulls.HullDefinition;
import hullcast.v1.Hulls.Simplification;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;
import java.security.MessageDigest;
import java.security.NoSuchAlgorithmException;
import java.util.Arrays;
import java.util.stream.DoubleStream;

/**
 * A cloud of points to register.
 *
 * @param vertices three numbers per point, in the hull's own frame
 * @param contractionPoint three numbers; or empty for the centre of mass
 * @param simplification null for no simplification
 * @param planarity if null, the server uses 1e-6
 */
record Hull(
    double[] vertices, double[] contractionPoint, Simplification simplification, Double planarity) {
  private static final int MAX_HEADER_BYTES = 40;

  Hull(double[] vertices, double[] contractionPoint) {
    this(vertices, contractionPoint, null, null);
  }

  /** The byte string that docs/identity.md defines. */
  byte[] identityBytes() {
    int numbers = contractionPoint.length + vertices.length;
    ByteBuffer bytes = ByteBuffer.allocate(MAX_HEADER_BYTES + Double.BYTES * numbers);
    bytes.order(ByteOrder.LITTLE_ENDIAN).put("hullcast".getBytes(StandardCharsets.US_ASCII));
    bytes.putInt(planarity == null ? 1 : 2); // the format's version
    put(bytes, contractionPoint.length > 0);
    put(bytes, contractionPoint);
    put(bytes, simplification != null);
    if (simplification != null) {
      put(bytes, simplification.hasMaxVertices());
      if (simplification.hasMaxVertices()) {
        bytes.putInt(simplification.getMaxVertices());
      }
      put(bytes, simplification.hasMaxDeviation());
      if (simplification.hasMaxDeviation()) {
        put(bytes, new double[] {simplification.getMaxDeviation()});
      }
    }
    if (planarity != null) {
      put(bytes, new double[] {planarity});
    }
    bytes.putInt(vertices.length / 3);
    put(bytes, vertices);
    return Arrays.copyOf(bytes.array(), bytes.position());
  }

  private static void put(ByteBuffer bytes, boolean present) {
    bytes.put((byte) (present ? 1 : 0));
  }

  private static void put(ByteBuffer bytes, double[] numbers) {
    for (double number : numbers) {
      bytes.putDouble(number + 0.0); // -0.0 is written as 0.0
    }
  }

  /** The hull's id on every server: 32 bytes. */
  ByteString id() {
    try {
      return ByteString.copyFrom(MessageDigest.getInstance("SHA-256").digest(identityBytes()));
    } catch (NoSuchAlgorithmException e) {
      throw new AssertionError("every Java has SHA-256", e);
    }
  }

  HullDefinition definition() {
    HullDefinition.Builder definition =
        HullDefinition.newBuilder()
            .addAllVertices(DoubleStream.of(vertices).boxed().toList())
            .addAllContractionPoint(DoubleStream.of(contractionPoint).boxed().toList());
    if (simplification != null) {
      definition.setSimplification(simplification);
    }
    if (planarity != null) {
      definition.setPlanarity(planarity);
    }
    return definition.build();
  }
}
