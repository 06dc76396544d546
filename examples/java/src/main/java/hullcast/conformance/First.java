package hullcast.conformance;

import hullcast.v1.ContactServiceGrpc;
import hullcast.v1.Contacts.QueryContactsRequest;
import hullcast.v1.HullServiceGrpc;
import hullcast.v1.Hulls.HullDefinition;
import hullcast.v1.Hulls.RegisterHullsRequest;
import io.grpc.Grpc;
import io.grpc.InsecureChannelCredentials;
import java.util.List;

final class First {
  public static void main(String[] args) {
    var channel = Grpc.newChannelBuilder(args[0], InsecureChannelCredentials.create()).build();
    var cube = HullDefinition.newBuilder().addAllVertices(List.of(
        0., 0., 0., 0., 0., 1., 0., 1., 0., 0., 1., 1., 1., 0., 0., 1., 0., 1., 1., 1., 0., 1., 1., 1.));
    var registered = HullServiceGrpc.newBlockingStub(channel)
        .registerHulls(RegisterHullsRequest.newBuilder().addHulls(cube).build());
    var m = ContactServiceGrpc.newBlockingStub(channel).queryContacts(QueryContactsRequest.newBuilder()
        .addHullIds(registered.getResults(0).getHull().getId())
        .addAllBodyHulls(List.of(0, 0)) // both bodies are the cube
        .addAllPositions(List.of(0., 0., 0., 0.2, 0., 0.99))
        .addAllRotations(List.of(0., 0., 0., 1., 0., 0., 0., 1.))
        .addAllPairs(List.of(0, 1)).setMargin(0.01).build());
    System.out.printf("alpha %.2f, separation %.2f, %d points%n",
        m.getAlphas(0), m.getSeparations(0), m.getPointCounts(0));
    channel.shutdownNow();
  }
}
