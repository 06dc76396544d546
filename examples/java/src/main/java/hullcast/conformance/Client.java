package hullcast.conformance;

import com.google.protobuf.Any;
import com.google.protobuf.ByteString;
import com.google.protobuf.InvalidProtocolBufferException;
import com.google.rpc.BadRequest;
import com.google.rpc.ErrorInfo;
import hullcast.v1.ContactServiceGrpc;
import hullcast.v1.Contacts.QueryContactsRequest;
import hullcast.v1.Contacts.QueryContactsResponse;
import hullcast.v1.HullServiceGrpc;
import hullcast.v1.Hulls.RegisterHullResult;
import hullcast.v1.Hulls.RegisterHullsRequest;
import hullcast.v1.Hulls.RegisterHullsResponse;
import io.grpc.CallCredentials;
import io.grpc.ChannelCredentials;
import io.grpc.Grpc;
import io.grpc.ManagedChannel;
import io.grpc.protobuf.StatusProto;
import io.grpc.stub.BlockingClientCall;
import java.util.ArrayList;
import java.util.List;
import java.util.stream.Stream;

/** The hull service and the contact service. */
final class Client implements AutoCloseable {
  /** The server's default message limit in both directions. gRPC's own default is 4 MiB. */
  private static final int MAX_MESSAGE_BYTES = 64 << 20;

  private final ManagedChannel channel;
  final HullServiceGrpc.HullServiceBlockingStub hulls;
  final ContactServiceGrpc.ContactServiceBlockingV2Stub contacts;

  /** @param token credentials to send with every call; null for none */
  Client(String target, ChannelCredentials credentials, CallCredentials token) {
    channel = Grpc.newChannelBuilder(target, credentials).maxInboundMessageSize(MAX_MESSAGE_BYTES).build();
    hulls = HullServiceGrpc.newBlockingStub(channel).withCallCredentials(token);
    contacts = ContactServiceGrpc.newBlockingV2Stub(channel).withCallCredentials(token);
  }

  @Override
  public void close() {
    channel.shutdownNow();
  }

  /** Registers hulls and returns their ids, after comparing them with those computed here. */
  List<ByteString> register(Hull... clouds) {
    RegisterHullsRequest.Builder request = RegisterHullsRequest.newBuilder();
    Stream.of(clouds).map(Hull::definition).forEach(request::addHulls);
    RegisterHullsResponse response = hulls.registerHulls(request.build());
    List<ByteString> ids = new ArrayList<>();
    for (RegisterHullResult result : response.getResultsList()) {
      Checks.expect(result.hasHull(), "%s", result.getError());
      ByteString id = result.getHull().getId();
      Checks.expect(id.equals(clouds[ids.size()].id()), "the server's id of hull %s", ids.size());
      ids.add(id);
    }
    return ids;
  }

  /** Sends each request after the answer to the previous one. */
  List<QueryContactsResponse> stream(List<QueryContactsRequest> requests) throws Exception {
    BlockingClientCall<QueryContactsRequest, QueryContactsResponse> call = contacts.streamContacts();
    List<QueryContactsResponse> answers = new ArrayList<>();
    for (QueryContactsRequest request : requests) {
      call.write(request);
      answers.add(call.read());
    }
    call.halfClose();
    Checks.expect(call.read() == null, "more answers than requests");
    return answers;
  }

  /** Describes an error by its code, reason and field. */
  static String refusal(Exception error) throws InvalidProtocolBufferException {
    String reason = "";
    String field = "";
    com.google.rpc.Status said = StatusProto.fromThrowable(error);
    for (Any detail : said.getDetailsList()) {
      if (detail.is(ErrorInfo.class)) {
        ErrorInfo info = detail.unpack(ErrorInfo.class);
        reason = info.getDomain() + "/" + info.getReason();
      } else if (detail.is(BadRequest.class)) {
        field = detail.unpack(BadRequest.class).getFieldViolations(0).getField();
      }
    }
    io.grpc.Status.Code code = io.grpc.Status.fromThrowable(error).getCode();
    return String.join(" ", code.name(), reason, field).trim();
  }
}
