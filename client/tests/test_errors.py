"""Exceptions and warnings can be pickled, copied and raised in other processes."""

from __future__ import annotations

import copy
import inspect
import multiprocessing
import pickle
import re
import warnings
from pathlib import Path

import grpc
import numpy as np
import pytest

import hullcast
from hullcast import _errors, _status

KINDS = {
    name: kind
    for name, kind in vars(_errors).items()
    if inspect.isclass(kind) and issubclass(kind, (Exception, Warning)) and not name.startswith("_")
}
#: The arguments of the classes that take more than a message.
ARGUMENTS = {
    "OutputNotAsked": ("alpha", "ALPHA"),
    "NotConvexWarning": ("is not convex", "hulls[2]", 0.5, 3),
    "InvalidPoses": ("some", np.array([1, 2]), ("far", "nan"), None),
}


def made(name: str) -> BaseException:
    """An exception or warning of a class, with every attribute set."""
    kind = KINDS[name]
    error = kind(*ARGUMENTS.get(name, ("it went wrong",)))
    if isinstance(error, hullcast.Error):
        error.reason, error.field, error.index = "SOME_REASON", "pairs", 3
        error.entry, error.retry_after = (1, 1), 0.5
    if isinstance(error, hullcast.HullRejected):
        error.point, error.results = 7, [hullcast.HullRejected("inner", point=1)]
    if isinstance(error, hullcast.Unavailable):
        error.cut_off = True
    return error


def described(error: BaseException) -> tuple[object, ...]:
    return type(error), str(error), error.args, repr(sorted(vars(error).items(), key=str))


@pytest.mark.parametrize("name", KINDS)
def test_all_survive_pickling_and_copying(name):
    """Catches a process pool that fails or hangs because an exception cannot be unpickled."""
    error = made(name)
    for protocol in range(pickle.HIGHEST_PROTOCOL + 1):
        again = pickle.loads(pickle.dumps(error, protocol))
        assert described(again)[:3] == described(error)[:3]
    assert described(copy.copy(error)) == described(error)
    assert str(copy.deepcopy(error)) == str(error)


def test_all_are_public_and_known():
    """Catches an exception class that is missing in this test or is not public."""
    assert len(KINDS) >= 15
    for name in KINDS:
        assert getattr(hullcast, name) is KINDS[name]


def _raises(name: str) -> None:
    error = made(name)
    if isinstance(error, Warning):
        warnings.warn(error, stacklevel=1)
    raise error


def test_a_pool_returns_them():
    """Catches a worker's exception, of any class, that hangs the pool."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        for name in KINDS:
            with pytest.raises(KINDS[name]) as caught:
                pool.apply_async(_raises, (name,)).get(60)
            assert str(caught.value) == str(made(name))


class CutCall:
    """A failed call, as gRPC reports a stream that the server reset."""

    def __init__(self, details: str) -> None:
        self._details = details

    def code(self) -> grpc.StatusCode:
        return grpc.StatusCode.CANCELLED

    def details(self) -> str:
        return self._details

    def trailing_metadata(self) -> tuple[()]:
        return ()


def test_a_call_that_the_server_cut_says_why():
    """Catches a number of HTTP/2 in place of the reason and the setting that decides."""
    error = _status.from_rpc(CutCall("Received RST_STREAM with error code 8"))
    assert isinstance(error, hullcast.ServerError)
    assert (error.reason, error.code) == ("CANCELLED", "CANCELLED")
    assert "not read in time" in str(error)
    assert "answer_seconds" in str(error)
    own = _status.from_rpc(CutCall("Locally cancelled by application!"))
    assert "answer_seconds" not in str(own)


def test_the_page_lists_every_reason_of_the_client():
    """Catches a reason that the client raises and the page lacks, and one that nothing raises.

    A test of the server compares the page's other table with the server's reasons.
    """
    root = Path(__file__).resolve().parents[2]
    sources = (root / "client/src/hullcast").rglob("*.py")
    texts = [path.read_text() for path in sources if "_pb" not in path.parts]
    raised = set(re.findall(r'reason(?:: str)? ?= ?"([A-Z_]+)"', " ".join(texts)))
    # Some classes take the reason as their second argument.
    words = set(re.findall(r'"([A-Z_]+)"', " ".join(texts)))
    table = (root / "docs/errors.md").read_text().split("## In the Python client")[1]
    cells = [line.split("|")[2] for line in table.splitlines() if line.startswith("| ")]
    listed = set(re.findall(r"\b[A-Z_]{2,}\b", " ".join(cells)))
    assert raised - listed == set()
    assert listed - words == set()
