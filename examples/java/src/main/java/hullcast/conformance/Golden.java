package hullcast.conformance;

import com.google.gson.Gson;
import com.google.gson.annotations.SerializedName;
import hullcast.v1.Hulls.Simplification;
import java.io.IOException;
import java.nio.file.Files;
import java.nio.file.Path;
import java.util.List;

/** The files that the clients of all languages read. */
final class Golden {
  /** A test vector of docs/identity.md. */
  record IdentityVector(
      String name,
      double[] vertices,
      @SerializedName("contraction_point") double[] contractionPoint,
      @SerializedName("max_vertices") Integer maxVertices,
      @SerializedName("max_deviation") Double maxDeviation,
      Double planarity,
      String id,
      String bytes) {
    Hull hull() {
      double[] point = contractionPoint == null ? new double[0] : contractionPoint;
      if (maxVertices == null && maxDeviation == null) {
        return new Hull(vertices, point, null, planarity);
      }
      Simplification.Builder simplification = Simplification.newBuilder();
      if (maxVertices != null) {
        simplification.setMaxVertices(maxVertices);
      }
      if (maxDeviation != null) {
        simplification.setMaxDeviation(maxDeviation);
      }
      return new Hull(vertices, point, simplification.build(), planarity);
    }
  }

  private record Cases(String format, List<Case> cases) {}

  private Golden() {}

  static List<Case> cases(Path root) throws IOException {
    String text = Files.readString(root.resolve("tests/golden/contacts.json"));
    Cases file = new Gson().fromJson(text, Cases.class);
    Checks.expect(file.format.equals("hullcast.golden.v1"), "format %s", file.format);
    return file.cases;
  }

  static List<IdentityVector> identityVectors(Path root) throws IOException {
    String page = Files.readString(root.resolve("docs/identity.md"));
    String block = page.split("```json\n", 2)[1].split("```", 2)[0];
    return List.of(new Gson().fromJson(block, IdentityVector[].class));
  }
}
