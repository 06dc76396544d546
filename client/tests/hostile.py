"""A mock server, which responds with bytes that a test provides, correct or not."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any

import grpc

Answer = Callable[[bytes], list[bytes]]


class Mock(grpc.GenericRpcHandler):
    """Responds to each method with a function of the request's bytes; it computes no contacts."""

    def __init__(self) -> None:
        self.answers: dict[str, Answer] = {}
        self.calls: list[str] = []

    def service(self, handler_call_details: Any) -> Any:
        name = handler_call_details.method.rpartition("/")[2]
        self.calls.append(name)
        answer = self.answers.get(name)
        if answer is None:
            return None
        if name == "StreamContacts":

            def each(requests: Iterator[bytes], _: object) -> Iterator[bytes]:
                for request in requests:
                    yield from answer(request)

            return grpc.stream_stream_rpc_method_handler(each)
        if name == "FindContacts":
            return grpc.unary_stream_rpc_method_handler(lambda request, _: iter(answer(request)))
        return grpc.unary_unary_rpc_method_handler(lambda request, _: answer(request)[0])


@contextmanager
def served(handler: grpc.GenericRpcHandler, threads: int) -> Iterator[str]:
    """Starts a server whose calls the handler answers, and yields its address."""
    with ThreadPoolExecutor(threads) as pool:
        server = grpc.server(pool, handlers=[handler], options=[("grpc.so_reuseport", 0)])
        port = server.add_insecure_port("127.0.0.1:0")
        server.start()
        try:
            yield f"127.0.0.1:{port}"
        finally:
            server.stop(None).wait()


@contextmanager
def mock_server() -> Iterator[tuple[Mock, str]]:
    """Starts a mock server, and yields it and its address."""
    mock = Mock()
    with served(mock, 8) as address:
        yield mock, address
