"""A server that hands every call on to a real server, and may change the messages on the way."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import grpc
from crowds import NO_PROXY
from hostile import served

from hullcast._pb import contacts_pb2, server_pb2

Request = contacts_pb2.QueryContactsRequest
Response = contacts_pb2.QueryContactsResponse


class Relay(grpc.GenericRpcHandler):
    """Hands calls on. Errors come back with their details, as from the server itself."""

    def __init__(self, target: str) -> None:
        self._channel = grpc.insecure_channel(target, options=NO_PROXY)
        #: Changes a request of a stream before the real server gets it.
        self.request: Callable[[Any], None] = lambda request: None
        #: Changes a response of a stream before the client gets it.
        self.response: Callable[[Any], None] = lambda response: None
        #: Changes the response of GetServerInfo.
        self.info: Callable[[Any], None] = lambda info: None
        #: The requests of all streams, as the client sent them.
        self.requests: list[Any] = []
        #: The number of bytes of the requests and of the responses of all streams.
        self.bytes = [0, 0]

    def service(self, handler_call_details: Any) -> Any:
        method = handler_call_details.method
        name = method.rpartition("/")[2]
        if name == "StreamContacts":
            return grpc.stream_stream_rpc_method_handler(
                lambda requests, context: self._passed(context, self._stream(method, requests))
            )
        if name == "FindContacts":
            call = self._channel.unary_stream(method)
            return grpc.unary_stream_rpc_method_handler(
                lambda request, context: self._passed(context, call(request))
            )
        one = self._channel.unary_unary(method)

        def answer(request: bytes, context: Any) -> bytes:
            data = next(self._passed(context, (one(each) for each in [request])))
            if name != "GetServerInfo":
                return data
            info = server_pb2.GetServerInfoResponse.FromString(data)
            self.info(info)
            return info.SerializeToString()

        return grpc.unary_unary_rpc_method_handler(answer)

    def _stream(self, method: str, requests: Iterator[bytes]) -> Iterator[bytes]:
        for data in self._channel.stream_stream(method)(self._sent(requests)):
            self.bytes[1] += len(data)
            response = Response.FromString(data)
            self.response(response)
            yield response.SerializeToString()

    def _sent(self, requests: Iterator[bytes]) -> Iterator[bytes]:
        with contextlib.suppress(grpc.RpcError):  # the client has ended its stream
            for data in requests:
                self.bytes[0] += len(data)
                request = Request.FromString(data)
                self.requests.append(Request.FromString(data))
                self.request(request)
                yield request.SerializeToString()

    def _passed(self, context: Any, answers: Iterator[bytes]) -> Iterator[bytes]:
        try:
            yield from answers
        except grpc.RpcError as error:
            failed: Any = error
            context.set_trailing_metadata(failed.trailing_metadata() or ())
            context.abort(failed.code(), failed.details())

    def be_old(self) -> None:
        """Behaves as a server from before find sessions: it ignores the new fields."""

        def forget(request: Any) -> None:
            request.find = False
            for name in ("moved", "previous_bodies"):
                request.ClearField(name)

        def silent(message: Any) -> None:
            message.ClearField("contract")

        self.request, self.response, self.info = forget, silent, silent


@contextmanager
def relayed(target: str) -> Iterator[tuple[Relay, str]]:
    """Starts a relay to the server at `target`, and yields it and its address."""
    relay = Relay(target)
    try:
        with served(relay, 16) as address:
            yield relay, address
    finally:
        relay._channel.close()
