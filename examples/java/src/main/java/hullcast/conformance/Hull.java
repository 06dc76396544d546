package hullcast.conformance;

import com.google.protobuf.ByteString;
import hullcast.v1.Hulls.HullDefinition;
import java.nio.ByteBuffer;
import java.nio.ByteOrder;
import java.nio.charset.StandardCharsets;
import java.security.MessageDigest;
import java.security.NoSuchAlgorithmException;
import java.util.stream.DoubleStream;

/**
 * A cloud of points to register.
 *
 * @param vertices three numbers a point, in the hull's own frame
 * @param contractionPoint empty (the centre of mass is taken) or three numbers
 */
record Hull(double[] vertices, double[] contractionPoint) {
  private static final int HEADER_BYTES = 18;

  /** The byte string of docs/identity.md. */
  byte[] identityBytes() {
    int numbers = contractionPoint.length + vertices.length;
    ByteBuffer bytes = ByteBuffer.allocate(HEADER_BYTES + Double.BYTES * numbers);
    bytes.order(ByteOrder.LITTLE_ENDIAN).put("hullcast".getBytes(StandardCharsets.US_ASCII));
    bytes.putInt(1); // the format's version
    bytes.put((byte) (contractionPoint.length == 0 ? 0 : 1));
    put(bytes, contractionPoint);
    bytes.put((byte) 0); // no simplification
    bytes.putInt(vertices.length / 3);
    put(bytes, vertices);
    return bytes.array();
  }

  private static void put(ByteBuffer bytes, double[] numbers) {
    for (double number : numbers) {
      bytes.putDouble(number + 0.0); // -0.0 is written as 0.0
    }
  }

  /** Names the hull on every server. */
  ByteString id() {
    try {
      return ByteString.copyFrom(MessageDigest.getInstance("SHA-256").digest(identityBytes()));
    } catch (NoSuchAlgorithmException e) {
      throw new AssertionError("every Java has SHA-256", e);
    }
  }

  HullDefinition definition() {
    return HullDefinition.newBuilder()
        .addAllVertices(DoubleStream.of(vertices).boxed().toList())
        .addAllContractionPoint(DoubleStream.of(contractionPoint).boxed().toList())
        .build();
  }
}
