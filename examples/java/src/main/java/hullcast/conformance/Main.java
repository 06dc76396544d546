package hullcast.conformance;

import io.grpc.InsecureChannelCredentials;
import java.nio.file.Path;
import java.util.List;

/**
 * Tests a server, and the generated code for Java, against the golden cases and the documented
 * errors. Prints the number of checks of each kind.
 *
 * <p>Arguments: ROOT TARGET [SECURE_TARGET AUTHORITY_PEM REGISTER_TOKEN QUERY_TOKEN]
 */
final class Main {
  private Main() {}

  public static void main(String[] args) throws Exception {
    Path root = Path.of(args[0]);
    List<Case> cases = Golden.cases(root);
    Case first = cases.get(0);
    try (Client client = new Client(args[1], InsecureChannelCredentials.create(), null)) {
      System.out.println("identities " + Checks.identities(root));
      System.out.println("answers " + Checks.answers(client, cases));
      System.out.println("errors " + Checks.errors(client, first));
      System.out.println("steps " + Checks.steps(client, first));
      System.out.println("loops " + Checks.loops(client, first));
      System.out.println("deadlines " + Checks.deadlines(client, first));
    }
    System.out.println("secured " + Secured.check(List.of(args).subList(2, args.length), first));
  }
}
