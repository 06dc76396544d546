"""Ten or more wrong values for every public parameter: messages name argument, value and range."""

from __future__ import annotations

import decimal
import fractions
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from crowds import CUBE, NO_PROXY

import hullcast

NAN, INF = float("nan"), float("inf")


class Opaque:
    """An object whose `repr` fails."""

    def __repr__(self) -> str:
        raise RuntimeError("no text")


#: Values that are not numbers.
NO_NUMBER: list[Any] = ["1", "1cm", b"1", [], [1.0], {}, {"a": 1}, 1j, object(), Opaque(), True]
REALS: list[Any] = [*NO_NUMBER, NAN, -1, -1e-300, -INF, np.float32(-1), 10**400 * -1]
TIMES: list[Any] = [
    *REALS,
    0,
    0.0,
    -0.0,
    np.int64(0),
    fractions.Fraction(-1, 3),
    decimal.Decimal("NaN"),
]
COUNTS: list[Any] = [*NO_NUMBER, -1, 1.0, 1.5, NAN, 2**40, None, np.float64(3)]
WORDS: list[Any] = ["", "x", "Raise", None, 1, 1.5, True, [], {}, b"raise", object()]
NO_ARRAY: list[Any] = [
    None,
    "abc",
    b"abc",
    {},
    {"a": 1},
    5,
    1.5,
    object(),
    Opaque(),
    [["a"]],
    [[None] * 3],
    [1, [2, 3]],
    1j,
]
#: Values that are not a vector for each of two bodies.
VECTORS: list[Any] = [*NO_ARRAY[1:], np.zeros(6), np.zeros((3, 3)), np.zeros((2, 4)), [[0, 0, 0]]]


def scene() -> hullcast.Scene:
    return hullcast.Scene([b"\1" * 32] * 2, np.zeros((2, 3)), [[0, 0, 0, 1]] * 2)


def ask(**options: Any) -> Callable[[hullcast.Client], Any]:
    return lambda client: client.query(scene(), [[0, 1]], **options)


def make(**changed: Any) -> Callable[[Any], Any]:
    arguments: dict[str, Any] = {
        "hulls": [b"\1" * 32] * 2, "positions": np.zeros((2, 3)), "rotations": [[0, 0, 0, 1]] * 2,
    }  # fmt: skip
    return lambda _: hullcast.Scene(**{**arguments, **changed})


def connect(**options: Any) -> Callable[[Any], Any]:
    return lambda _: hullcast.connect(options.pop("target", "localhost"), **options)


#: For each parameter: a call with a value for it, and the values that must be refused.
PARAMETERS: dict[str, tuple[Callable[[Any], Callable[[Any], Any]], list[Any]]] = {
    "query.timeout": (lambda v: ask(timeout=v), TIMES),
    "query.margin": (lambda v: ask(margin=v), [*REALS, None]),
    "query.on_invalid": (lambda v: ask(on_invalid=v), WORDS),
    "query.outputs": (lambda v: ask(outputs=v), ["X", 5, True, {"ALPHA": 1}, [None], [1], b"ALPHA", "UNSPECIFIED", ["ALPHA", ""], object(), [["ALPHA"]]]),
    "query.accuracy": (lambda v: ask(accuracy=v), ["EXACT", 0, 1, True, {}, {"max_points": 1}, [], (), object(), Opaque(), hullcast.Accuracy]),
    "query.warm": (lambda v: ask(warm=v), ["m", 0, 1, True, {}, [], (), object(), Opaque(), np.zeros((1, 6)), hullcast.Manifolds]),
    "query.pairs": (lambda v: lambda c: c.query(scene(), v), [*NO_ARRAY, [0, 1], [[0, 2]], [[0, -1]], [[0.0, 1.0]], [[0, 1, 2]], [[True, False]]]),
    "query.scene": (lambda v: lambda c: c.query(v, [[0, 1]]), [None, 1, "s", b"s", {}, [], [1], (), object(), Opaque(), hullcast.Scene, np.zeros(3)]),
    "find.scene": (lambda v: lambda c: c.find(v), [None, 1, "s", b"s", {}, [], [1], (), object(), Opaque(), hullcast.Scene]),
    "find.margin": (lambda v: lambda c: c.find(scene(), margin=v), [*REALS, None, INF]),
    "find.timeout": (lambda v: lambda c: c.find(scene(), timeout=v), TIMES),
    "find.on_invalid": (lambda v: lambda c: c.find(scene(), on_invalid=v), WORDS),
    "query.linear_velocities": (lambda v: ask(linear_velocities=v), VECTORS),
    "query.angular_velocities": (lambda v: ask(angular_velocities=v), VECTORS),
    "query.turning_points": (lambda v: ask(turning_points=v), VECTORS),
    "query.time_step": (lambda v: ask(time_step=v), [*REALS, None, INF, 1.01e100]),
    "find.linear_velocities": (lambda v: lambda c: c.find(scene(), linear_velocities=v), VECTORS),
    "find.angular_velocities": (lambda v: lambda c: c.find(scene(), angular_velocities=v), VECTORS),
    "find.turning_points": (lambda v: lambda c: c.find(scene(), turning_points=v), VECTORS),
    "find.time_step": (lambda v: lambda c: c.find(scene(), time_step=v), [*REALS, None, INF]),
    "session.margin": (lambda v: lambda c: c.session(scene(), [[0, 1]], margin=v), [*REALS, None]),
    "session.on_invalid": (lambda v: lambda c: c.session(scene(), [[0, 1]], on_invalid=v), WORDS),
    "step.timeout": (lambda v: lambda c: c.session(scene(), [[0, 1]]).step(np.zeros((2, 3)), [[0, 0, 0, 1]] * 2, timeout=v), TIMES),
    "step.positions": (lambda v: lambda c: c.session(scene(), [[0, 1]]).step(v, [[0, 0, 0, 1]] * 2), [*NO_ARRAY, np.zeros((3, 3)), np.zeros((2, 4))]),
    "step.rotations": (lambda v: lambda c: c.session(scene(), [[0, 1]]).step(np.zeros((2, 3)), v), [*NO_ARRAY, np.zeros((3, 4)), np.zeros((2, 3))]),
    "session.find": (lambda v: lambda c: c.session(scene(), find=v), [None, 0, 1, "x", "True", 1.5, [], {}, (), object(), Opaque(), np.zeros(2)]),
    "session.pairs": (lambda v: lambda c: c.session(scene(), v), [*NO_ARRAY, [0, 1], [[0, 2]], [[0, -1]], [[0.0, 1.0]]]),
    "session.outputs": (lambda v: lambda c: c.session(scene(), find=True, outputs=v), ["X", 5, True, {"MATCHES": 1}, [None], [1], b"MATCHES", "UNSPECIFIED", ["MATCHES", ""], object()]),
    "step.moved": (lambda v: lambda c: c.session(scene(), find=True).step(np.zeros((2, 3)), [[0, 0, 0, 1]] * 2, moved=v), [*[v for v in NO_ARRAY if v is not None], [0, 2], [-1, 0], [0.0, 1.0], [True, False], [1, 1], [[0, 1]]]),
    "update.scene": (lambda v: lambda c: c.session(scene(), find=True).update(v), [None, 1, "s", b"s", {}, [], [1], (), object(), Opaque(), hullcast.Scene]),
    "update.previous": (lambda v: lambda c: c.session(scene(), find=True).update(scene(), previous=v), [*[v for v in NO_ARRAY if v is not None], [0], [0, 2], [-2, 0], [0.0, 1.0], [True, False], [1, 1], [[0, 1]], [0, 2**32 - 1], [0, 2**70]]),
    "update.timeout": (lambda v: lambda c: c.session(scene(), find=True).update(scene(), timeout=v), TIMES),
    "match.before": (lambda v: lambda _: hullcast.match(v, v), [None, 1, "s", b"s", {}, [], [1], (), object(), Opaque(), hullcast.Manifolds]),
    "register.hulls": (lambda v: lambda c: c.register(v), [None, 1, 1.5, True, b"x", {"box": CUBE}, object(), [None], [1], [CUBE[:, :2]], [[["a", "b", "c"]]], CUBE * 1j]),
    "register.timeout": (lambda v: lambda c: c.register(CUBE, timeout=v), TIMES),
    "register.max_vertices": (lambda v: lambda c: c.register(CUBE, max_vertices=v), [v for v in COUNTS if v is not None] + [3, 0]),
    "register.max_deviation": (lambda v: lambda c: c.register(CUBE, max_deviation=v), [*REALS, INF]),
    "register.planarity": (lambda v: lambda c: c.register(CUBE, planarity=v), [*NO_NUMBER, "Default"]),
    "register.contraction_points": (lambda v: lambda c: c.register([CUBE], contraction_points=v), [1, 1.5, "x", b"x", {}, [], [None, None], [[0, 0]], ["abc"], object(), [[NAN, "a", 0]]]),
    "info.timeout": (lambda v: lambda c: c.info(timeout=v), TIMES),
    "ping.timeout": (lambda v: lambda c: c.ping(timeout=v), TIMES),
    "hulls.timeout": (lambda v: lambda c: c.hulls(timeout=v), TIMES),
    "delete.timeout": (lambda v: lambda c: c.delete([], timeout=v), TIMES),
    "delete.hulls": (lambda v: lambda c: c.delete(v), [None, 1, 1.5, "x", {}, {"a": b"\1" * 32}, [1], [b"x"], b"x", CUBE, object()]),
    "connect.timeout": (lambda v: connect(timeout=v), TIMES),
    "connect.target": (lambda v: connect(target=v), [None, 1, 1.5, True, b"x", {}, [], "", ":1", "host:", "host:0", "host:65536", "host:-1", "host:x", "a b", "ftp://host", "http://", "http://a/b", "::1", "u@h:1", "unix:", [1], ["a", "unix:x"], ["http://a", "b"], object()]),
    "connect.token": (lambda v: connect(token=v), ["", " ", "\n", "a b", "a\nb", "ä", "a\0", "x" * 100_000, 1, b"x", True, [], {}]),
    "connect.tls": (lambda v: connect(tls=v), ["", "/nonexistent", "/", b"", b"x", b"-----BEGIN CERTIFICATE-----", __file__, 1, 1.5, [], {}, object()]),
    "connect.subset": (lambda v: connect(target=["a", "b"], subset=v), [0, -1, 2**31, 1.5, True, "2", b"2", [], [2], {}, np.nan, np.inf, object()]),
    "connect.identity": (lambda v: connect(identity=v), ["", " ", "a b", "a\n", "ä", "a\0", "x" * 201, b"x", 1, True, [], {}, object()]),
    "connect.options": (lambda v: connect(options=v), [1, 1.5, True, "x", b"x", [1], ["ab"], [("a",)], [(1, 2)], [("a", None)], [("a", 1.5)], [("a", 2**31)], object()]),
    "client.pairs_per_message": (lambda v: lambda c: setattr(c, "pairs_per_message", v), [*COUNTS, 0]),
    "serve.timeout": (lambda v: lambda _: hullcast.serve(timeout=v), TIMES),
    "serve.start_timeout": (lambda v: lambda _: hullcast.serve(start_timeout=v), TIMES),
    "serve.store": (lambda v: lambda _: hullcast.serve(v), ["", 1, 1.5, True, b"", [], {}, (), object(), Opaque()]),
    "serve.listen": (lambda v: lambda _: hullcast.serve(listen=v), [None, "", "x", 1, 1.5, True, b"x:1", [], {}, object()]),
    "serve.arguments": (lambda v: lambda _: hullcast.serve(arguments=v), [None, 1, 1.5, True, "x", b"x", {}, [1], [None], ["a\0"], object()]),
    "Accuracy.solver": (lambda v: lambda _: hullcast.Accuracy(solver=v), [*WORDS, "gjk", "UNSPECIFIED"]),
    "Accuracy.relative_tolerance": (lambda v: lambda _: hullcast.Accuracy(relative_tolerance=v), [*REALS, None, 1.1, INF]),
    "Accuracy.feature_angle": (lambda v: lambda _: hullcast.Accuracy(feature_angle=v), [*REALS, None, 0.51, INF]),
    "Accuracy.max_points": (lambda v: lambda _: hullcast.Accuracy(max_points=v), COUNTS),
    "Scene.hulls": (lambda v: make(hulls=v), [None, 1, "x", {}, {"a": b"\1" * 32}, [1], [b"x"], [None], [CUBE], CUBE, object()]),
    "Scene.positions": (lambda v: make(positions=v), [*NO_ARRAY, np.zeros((3, 3)), np.zeros((2, 2))]),
    "Scene.rotations": (lambda v: make(rotations=v), [*NO_ARRAY, np.zeros((2, 3)), np.zeros((2, 2, 2))]),
    "Scene.body_hulls": (lambda v: make(body_hulls=v), [v for v in NO_ARRAY if v is not None] + [[0, 2], [0, -1], [0.0, 1.0]]),
    "Scene.worlds": (lambda v: make(worlds=v), [v for v in NO_ARRAY if v is not None] + [[0], [0, -1], [0, 2**32]]),
    "Scene.groups": (lambda v: make(groups=v), [v for v in NO_ARRAY if v is not None] + [[0], [0, -1], [0, 2**32]]),
    "Scene.margins": (lambda v: make(margins=v), [*NO_ARRAY[1:], [0], [0, -1], [0, NAN], [0, INF], [0, 1.01e100], [[0, 0]]]),
    "Scene.ignored_groups": (lambda v: make(ignored_groups=v), [v for v in NO_ARRAY if v is not None] + [[0, 1], [[0, 1]], [[1, -1]]]),
    "from_wxyz.quaternions": (lambda v: lambda _: hullcast.from_wxyz(v), NO_ARRAY),
    "hull_id.vertices": (lambda v: lambda _: hullcast.hull_id(v), NO_ARRAY),
    "hull_id.max_vertices": (lambda v: lambda _: hullcast.hull_id(CUBE, max_vertices=v), [v for v in COUNTS if v is not None]),
    "hull_id.max_deviation": (lambda v: lambda _: hullcast.hull_id(CUBE, max_deviation=v), [*REALS, INF]),
    "hull_id.planarity": (lambda v: lambda _: hullcast.hull_id(CUBE, planarity=v), [*NO_NUMBER, "Default"]),
    "hull_id.contraction_point": (lambda v: lambda _: hullcast.hull_id(CUBE, v), [v for v in NO_ARRAY if v is not None]),
}  # fmt: skip
#: Phrases by which a message states the allowed values.
ALLOWED = ("expected", "allowed", "missing", "there is no such file", "not a file", "in PEM form", "is not a rotation")  # fmt: skip


@pytest.fixture(scope="module")
def idle() -> Any:
    """A client that never connects, because every error is found before a call."""
    with hullcast.connect("127.0.0.1:1", options=NO_PROXY) as client:
        yield client


@pytest.mark.parametrize("parameter", PARAMETERS)
def test_wrong_values_are_named(idle, parameter):
    """Catches a plain TypeError, a wrong value that is used, and a message without its argument."""
    call, values = PARAMETERS[parameter]
    name = parameter.rpartition(".")[2]
    assert len(values) >= 10
    for value in values:
        with pytest.raises(hullcast.InvalidArgument) as caught:
            call(value)(idle)
        error, text = caught.value, str(caught.value)
        shown = f"{type(value).__name__} for {parameter}: {text}"
        assert error.field.startswith(name), shown
        assert error.reason, shown
        assert name in text, shown
        assert any(word in text for word in ALLOWED), shown
        assert len(text) < 400, shown


@pytest.mark.parametrize("value", [INF, NAN, -INF, 10**400])
def test_infinity_is_refused_with_the_range(idle, value):
    """Catches "got inf, expected a number, 0 or more", which infinity seems to be."""
    for call in (
        lambda: idle.find(scene(), margin=value),
        lambda: idle.register(CUBE, max_deviation=value),
        lambda: hullcast.hull_id(CUBE, max_deviation=value),
        lambda: hullcast.Shape(CUBE, value),
    ):
        with pytest.raises(hullcast.InvalidArgument, match="expected a finite number, 0 or more"):
            call()
    if value != INF and value != 10**400:
        with pytest.raises(hullcast.InvalidArgument, match="0 or more, or infinity"):
            idle.query(scene(), [[0, 1]], margin=value)


def test_an_id_that_no_server_gives_is_not_computed():
    """Catches the id of points that are not finite, or of a planarity that servers refuse."""
    for arguments, field in (
        ({"vertices": CUBE * NAN}, "vertices"),
        ({"vertices": np.where(CUBE > 0, INF, 0.0)}, "vertices"),
        ({"contraction_point": [0, NAN, 0]}, "contraction_point"),
        ({"max_vertices": 3}, "max_vertices"),
        ({"planarity": INF}, "planarity"),
        ({"planarity": NAN}, "planarity"),
        ({"planarity": -1e-9}, "planarity"),
        ({"planarity": 0.011}, "planarity"),
    ):
        with pytest.raises(hullcast.InvalidArgument, match="expected") as caught:
            hullcast.hull_id(**{"vertices": CUBE, **arguments})
        assert caught.value.field == field
    assert len(hullcast.hull_id(CUBE, planarity=0.01)) == 32


TOKENS = ["reader-secret\n", "  reader-secret", "reader-secret\r\n"]


@pytest.mark.parametrize("token", TOKENS)
def test_a_token_is_stripped(token):
    """Catches a line break from a token file that is sent as part of the token."""
    assert hullcast.connect("localhost", token=token)._settings.token == "reader-secret"


@pytest.mark.parametrize(
    "seconds",
    [INF, 1e300, 10**400, 1e9, 5, 5.5, np.float32(5), np.int64(5), np.float64(INF), fractions.Fraction(11, 2), decimal.Decimal(5)],
    ids=str,
)  # fmt: skip
def test_one_rule_for_all_timeouts(client, seconds):
    """Catches infinity, or a number too large for a clock, that ends a call at once; any type."""
    scene = hullcast.Scene(client.register(CUBE, timeout=seconds), np.zeros((1, 3)), [[0, 0, 0, 1]])
    assert client.query(scene, [[0, 0]], timeout=seconds).in_contact.all()
    assert len(client.find(scene, timeout=seconds)) == 0
    with client.session(scene, [[0, 0]]) as session:
        assert session.step(scene.positions, scene.rotations, timeout=seconds).in_contact.all()
    with hullcast.connect(client.target, timeout=seconds, options=NO_PROXY) as other:
        assert other.query(scene, [[0, 0]]).in_contact.all()
        assert other.timeout is None or other.timeout == float(seconds)


@pytest.mark.parametrize("seconds", [1e-9, 5e-324, np.float64(1e-12)])
def test_a_short_timeout_is_late(client, seconds):
    """Catches a call that succeeds although its timeout has passed."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    with client.session(scene, [[0, 0]]) as session:
        for call in (
            lambda: client.query(scene, [[0, 0]], timeout=seconds),
            lambda: client.find(scene, timeout=seconds),
            lambda: client.register(CUBE, timeout=seconds),
            lambda: client.info(timeout=seconds),
            lambda: session.step(scene.positions, scene.rotations, timeout=seconds),
        ):
            with pytest.raises(hullcast.DeadlineExceeded):
                call()
        assert session.step(scene.positions, scene.rotations).in_contact.all()


def test_pairs_of_any_iterable(client):
    """Catches a generator that is refused or read twice.

    Errors name the index by row and column.
    """
    import itertools

    scene = hullcast.Scene(
        client.register(CUBE), np.zeros((3, 3)), [[0, 0, 0, 1]] * 3, body_hulls=[0] * 3
    )
    expected = [[0, 1], [0, 2], [1, 2]]
    for pairs in (
        itertools.combinations(range(3), 2),
        list(itertools.combinations(range(3), 2)),
        (pair for pair in expected),
        {(0, 1): "a", (0, 2): "b", (1, 2): "c"}.keys(),
        zip([0, 0, 1], [1, 2, 2], strict=True),
        np.array(expected, dtype=np.int8),
    ):
        assert client.query(scene, pairs).pairs.tolist() == expected
    assert len(client.query(scene, iter(()))) == 0
    with pytest.raises(hullcast.InvalidArgument) as caught:
        client.query(scene, [[0, 1], [2, 7]])
    assert str(caught.value) == (
        "INDEX_OUT_OF_RANGE: pairs[1, 1]: 7 is out of range: the scene has 3 bodies, so that 0 to 2 is allowed"
    )
    assert (caught.value.entry, caught.value.index) == ((1, 1), 3)


#: For each parameter whose entries have an order: a call with a set for it.
SETS: dict[str, Callable[[Any], Any]] = {
    "query.pairs": lambda c: c.query(scene(), {(0, 1), (1, 0)}),
    "query.pairs ": lambda c: c.query(scene(), [{0, 1}, {1, 0}]),
    "session.pairs": lambda c: c.session(scene(), {(0, 1), (1, 0)}),
    "session.positions": lambda c: c.session(scene(), [[0, 1]]).step({1.0, 2.0}),
    "register.hulls": lambda c: c.register({hullcast.box(1), hullcast.box(2)}),
    "register.hulls[0]": lambda c: c.register([frozenset(map(tuple, CUBE))]),
    "register.contraction_points": lambda c: c.register([CUBE] * 2, contraction_points={None, 1}),
    "Scene.hulls": make(hulls={b"\1" * 32, b"\2" * 32}),
    "Scene.positions": make(positions={(0, 0, 0), (0, 0, 1)}),
    "Scene.rotations": make(rotations={(0, 0, 0, 1), (0, 0, 1, 0)}),
    "Scene.body_hulls": make(body_hulls={0, 1}),
    "Scene.worlds": make(worlds={2, 1}),
    "Scene.groups": make(groups=frozenset({2, 1})),
    "Scene.margins": make(margins={0.0, 1.0}),
    "Scene.ignored_groups": make(ignored_groups={(1, 2), (2, 3)}),
    "moved.positions": lambda _: scene().moved({(0, 0, 0), (0, 0, 1)}, [[0, 0, 0, 1]] * 2),
    "from_wxyz.quaternions": lambda _: hullcast.from_wxyz({(1, 0, 0, 0)}),
    "hull_id.vertices": lambda _: hullcast.hull_id(set(map(tuple, CUBE))),
    "hull_id.contraction_point": lambda _: hullcast.hull_id(CUBE, {0.1, 0.2, 0.3}),
    "concat.manifolds": lambda _: hullcast.Manifolds.concat(set()),
    "serve.arguments": lambda _: hullcast.serve(arguments={"--compute-threads", "4"}),
    "Robot.packages": lambda _: hullcast.Robot(__file__, packages={"a", "b"}),
}


@pytest.mark.parametrize("parameter", SETS)
def test_a_set_has_no_order(idle, parameter):
    """Catches a set whose entries were taken in an arbitrary order, for example as worlds."""
    with pytest.raises(hullcast.InvalidArgument, match="a set has no order") as caught:
        SETS[parameter](idle)
    assert caught.value.field == parameter.rpartition(".")[2].strip()
    assert caught.value.reason == "NO_ORDER"


def test_a_set_of_indices_of_pairs_has_no_order(client):
    """Catches `m[{2, 0}]`, and a set of joint values."""
    scene = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), [[0, 0, 0, 1]])
    m = client.query(scene, [[0, 0]] * 3)
    for call in (lambda: m[{2, 0}], lambda: m.plot(pairs={2, 0}), lambda: m.log(pairs={2, 0})):
        with pytest.raises(hullcast.InvalidArgument, match="a set has no order"):
            call()


def test_missing_rotations_are_said_to_be_missing():
    """Catches a message about an argument that does not exist."""
    with pytest.raises(hullcast.InvalidArgument, match="MISSING_ARGUMENT: rotations: missing"):
        hullcast.Scene([b"\1" * 32] * 2, np.zeros((2, 3)))


def test_plain_with_of_the_asyncio_client():
    """Catches Python's own TypeError, which does not say to write `async with`."""
    for entered in (hullcast.aio.connect("localhost"), hullcast.aio.serve()):
        with pytest.raises(TypeError, match="async with"), entered:
            pass
