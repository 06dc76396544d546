"""Arrays that numpy would misread: masks, arrays of objects, and values that have names."""

from __future__ import annotations

import decimal
import fractions
from collections.abc import Callable
from typing import Any

import numpy as np
import pandas
import pytest
from crowds import CUBE
from test_arguments import idle, make, scene  # noqa: F401
from test_wrong_values import ROBOT

import hullcast

TURNS = [[0, 0, 0, 1]] * 2
TWO_JOINTS = ROBOT.replace(
    "</robot>",
    '<link name="c"/><joint name="k" type="prismatic"><parent link="b"/><child link="c"/>'
    '<limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>',
)


@pytest.fixture
def robot(tmp_path) -> hullcast.Robot:
    """A robot with the joints j and k, of which only j moves a body."""
    (tmp_path / "r.urdf").write_text(TWO_JOINTS)
    return hullcast.Robot(tmp_path / "r.urdf")


class Mesh:
    """A mesh with the given vertices."""

    def __init__(self, vertices: Any) -> None:
        self.vertices = vertices


def rows(array: Any, place: Any) -> list[Any]:
    """The rows of an array, one of which is masked at `place`."""
    masked = [np.ma.masked_array(row) for row in np.asarray(array)]
    masked[place[0]][place[1]] = np.ma.masked
    return masked


POSITIONS, SPUN = np.zeros((2, 3)), np.array(TURNS, dtype=float)
#: For each argument that takes arrays: calls with a masked number in it.
MASKED: dict[str, Callable[[Any, Any, Any], Any]] = {
    "Scene.positions": lambda c, m, r: make(positions=rows(POSITIONS, (1, 0)))(c),
    "Scene.positions of numbers": lambda c, m, r: make(positions=[[0, 0, 0], [0, np.ma.masked, 0]])(c),
    "Scene.rotations": lambda c, m, r: make(rotations=rows(SPUN, (0, 3)))(c),
    "Scene.matrices": lambda c, m, r: make(positions=rows([np.eye(4)] * 2, (0, 3)), rotations=None)(c),
    "Scene.worlds": lambda c, m, r: make(worlds=np.ma.masked_array([0, 1], [False, True]))(c),
    "Scene.groups": lambda c, m, r: make(groups=[1, np.ma.masked])(c),
    "moved.positions": lambda c, m, r: scene().moved(rows(POSITIONS, (1, 0)), SPUN),
    "step.positions": lambda c, m, r: c.session(scene(), [[0, 1]]).step(rows(POSITIONS, (1, 0)), SPUN),
    "query.pairs": lambda c, m, r: c.query(scene(), rows([[0, 1], [1, 0]], (1, 1))),
    "query.margin": lambda c, m, r: c.query(scene(), [[0, 1]], margin=np.ma.masked),
    "query.timeout": lambda c, m, r: c.query(scene(), [[0, 1]], timeout=np.ma.masked),
    "register.hulls": lambda c, m, r: c.register([rows(CUBE, (2, 1))]),
    "register.hulls of rows": lambda c, m, r: c.register(rows(CUBE, (2, 1))),
    "register.vertices": lambda c, m, r: c.register(Mesh(rows(CUBE, (2, 1)))),
    "register.contraction_points": lambda c, m, r: c.register([CUBE], contraction_points=[[0, 0, np.ma.masked]]),
    "register.max_deviation": lambda c, m, r: c.register(CUBE, max_deviation=np.ma.masked),
    "register.planarity": lambda c, m, r: c.register(CUBE, planarity=np.ma.masked),
    "register.max_vertices": lambda c, m, r: c.register(CUBE, max_vertices=np.ma.masked_array(8, True)),
    "from_wxyz.quaternions": lambda c, m, r: hullcast.from_wxyz(rows(SPUN, (0, 3))),
    "Robot.poses.joints": lambda c, m, r: r.poses(np.ma.masked_array([0.5, 0], [True, False])),
    "Robot.poses.joints by name": lambda c, m, r: r.poses({"j": np.ma.masked}),
    "Robot.poses.base": lambda c, m, r: r.poses(base=np.ma.masked_array(np.eye(4), np.eye(4))),
    "Manifolds[]": lambda c, m, r: m[np.ma.masked_array([0, 1], [True, False])],
    "Manifolds[] of numbers": lambda c, m, r: m[[0, np.ma.masked]],
    "Manifolds[] of one number": lambda c, m, r: m[np.ma.masked],
    "plot.pairs": lambda c, m, r: m.plot(pairs=np.ma.masked_array([0, 1], [True, False])),
    "log.pairs": lambda c, m, r: m.log(pairs=[0, np.ma.masked]),
}  # fmt: skip


@pytest.fixture(scope="module")
def m(client) -> hullcast.Manifolds:
    """Three pairs."""
    one = hullcast.Scene(client.register(CUBE), np.zeros((1, 3)), TURNS[:1])
    return client.query(one, [[0, 0]] * 3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("argument", MASKED)
def test_a_mask_is_never_dropped(idle, m, robot, argument):  # noqa: F811
    """Catches a masked number that is used as if it were not masked, also inside lists."""
    with pytest.raises(hullcast.InvalidArgument, match="masked"):
        MASKED[argument](idle, m, robot)


def test_an_array_without_masked_entries_is_an_array(m):
    """Catches a masked array that is refused although nothing in it is masked."""
    assert len(m[np.ma.masked_array([0, 1], [False, False])]) == 2
    assert len(make(positions=list(np.ma.masked_array(POSITIONS)))(None)) == 2


#: Values that a plain array would refuse, and the text by which a message shows them.
ODD = [
    (np.datetime64("2020-01-01"), "2020"),
    (np.timedelta64(5, "ns"), "5"),
    (np.timedelta64(5), "5"),
    (np.complex128(1j), "1j"),
    ("0", "'0'"),
    (b"0", "b'0'"),
    (None, "None"),
    (pandas.NA, "NA"),
    (True, "True"),
    ([1, 2], "[1, 2]"),
    (10**400, "1000000"),
]


@pytest.mark.parametrize(("value", "text"), ODD, ids=lambda value: f"{value!s:.12}")
def test_an_array_of_objects_admits_only_numbers(m, robot, value, text):
    """Catches a date, a word or a complex number that becomes a float; the place is named."""

    def objects(shape: tuple[int, ...], place: tuple[int, ...]) -> Any:
        array = np.zeros(shape, dtype=object)
        array[place] = value
        return array

    calls = {
        "positions[1, 2]": lambda: make(positions=objects((2, 3), (1, 2)))(None),
        "rotations[0, 1]": lambda: make(rotations=objects((2, 4), (0, 1)))(None),
        "quaternions[3]": lambda: hullcast.from_wxyz(objects((4,), (3,))),
        "joints[1]": lambda: robot.poses(objects((2,), (1,))),
        "joints[1, 0]": lambda: robot.poses(objects((3, 2), (1, 0))),
        "base[0, 1]": lambda: robot.poses(base=objects((4, 4), (0, 1))),
        "worlds[1]": lambda: make(worlds=objects((2,), (1,)))(None),
        "index[1]": lambda: m[objects((3,), (1,))],
    }
    for place, call in calls.items():
        with pytest.raises(hullcast.InvalidArgument) as caught:
            call()
        assert f"{place}: " in str(caught.value), caught.value
        assert text in str(caught.value), caught.value
        assert "float64" not in str(caught.value), caught.value


@pytest.mark.parametrize(
    "value", [np.timedelta64(5), np.timedelta64(5, "ns"), np.datetime64(5, "s")]
)
def test_a_time_is_not_a_number(idle, robot, value):  # noqa: F811
    """Catches `margin=numpy.timedelta64(5, "ns")`, whose item is the int 5."""
    for call in (
        lambda: idle.query(scene(), [[0, 1]], margin=value),
        lambda: idle.query(scene(), [[0, 1]], timeout=value),
        lambda: hullcast.prism(value, 1, 1),
        lambda: robot.poses({"j": value}),
    ):
        with pytest.raises(hullcast.InvalidArgument, match="expected"):
            call()


def test_arrays_of_objects_keep_their_kind_of_number(idle, m):  # noqa: F811
    """Catches integers and truth values that are refused, or called floats, because they are objects."""
    assert len(m[np.array([0, 1], dtype=object)]) == 2
    assert len(m[pandas.array([True, False, True], dtype="boolean")]) == 2
    assert len(m[pandas.Series([True, False, True], dtype="boolean")]) == 2
    assert len(make(worlds=np.array([0, 2**32 - 1], dtype=object))(None)) == 2
    assert make(positions=[[decimal.Decimal("0.5"), fractions.Fraction(1, 4), 1]] * 2)(
        None
    ).positions[0].tolist() == [0.5, 0.25, 1]
    assert make(positions=[[2**70, 0, 0]] * 2)(None).positions[0, 0] == 2.0**70
    with pytest.raises(hullcast.InvalidArgument, match=r"INDEX_OUT_OF_RANGE: pairs\[0, 1\]: 7 is"):
        idle.query(scene(), np.array([[0, 7]], dtype=object))
    with pytest.raises(
        hullcast.InvalidArgument, match=rf"INDEX_OUT_OF_RANGE: worlds\[0\]: {2**64} is"
    ):
        make(worlds=[2**64, 0])(None)
    with pytest.raises(
        hullcast.PairOutOfRange, match=rf"INDEX_OUT_OF_RANGE: index\[1\]: {2**70} is"
    ):
        m[[0, 2**70]]


def test_indices_of_pairs_of_a_wrong_type_name_the_type(m):
    """Catches "got shape (2,)" for `m[[0.0, 1.0]]`, and a generator that only `plot` accepts."""
    for index, text in (([0.0, 1.0], "float64"), (["a", "b"], "<U1"), ([[0], [1]], "shape (2, 1)")):
        with pytest.raises(IndexError) as caught:
            m[index]
        assert text in str(caught.value)
        assert "expected an integer, a slice, integers (k,) or a mask (3,)" in str(caught.value)
    assert len(m[(i for i in (0, 2))]) == 2
    with pytest.raises(hullcast.PairOutOfRange, match=r"index\[0\]: got <NA>"):
        m[pandas.array([None, True, False], dtype="boolean")]


def test_joint_values_with_names_are_taken_by_name(robot):
    """Catches a Series or a data frame whose values are taken by position, whatever its names."""
    expected = robot.poses([0.5, 0.1])
    for joints in (
        {"k": 0.1, "j": 0.5},
        pandas.Series({"k": 0.1, "j": 0.5}),
        pandas.DataFrame({"k": [0.1], "j": [0.5]}).iloc[0],
        pandas.Series([0.5, 0.1]),
    ):
        assert (robot.poses(joints) == expected).all()
    table = pandas.DataFrame({"k": [0.1, 0.0], "j": [0.5, 0.2]})
    assert (robot.poses(table) == robot.poses([[0.5, 0.1], [0.2, 0.0]])).all()
    assert (robot.poses(table[["j"]]) == robot.poses([[0.5, 0.0], [0.2, 0.0]])).all()
    assert (robot.poses(pandas.DataFrame([[0.5, 0.1]])) == robot.poses([[0.5, 0.1]])).all()
    for joints, reason in (
        (pandas.Series({"elbow": 2.0, "j": 0.0}), "UNKNOWN_JOINT"),
        (pandas.Series([1.0, 2.0], index=[3, 5]), "UNKNOWN_JOINT"),
        (pandas.DataFrame({"elbow": [2.0]}), "UNKNOWN_JOINT"),
        (pandas.Series([1.0, 2.0], index=["j", "j"]), "REPEATED_NAME"),
        (pandas.DataFrame([[1.0, 2.0]], columns=["j", "j"]), "REPEATED_NAME"),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            robot.poses(joints)
        assert (caught.value.reason, caught.value.field) == (reason, "joints")


def test_joint_values_and_bases_are_named_as_they_were_given(robot):
    """Catches `joints[0, 0]` for a value in one dimension or by name, and `base[0]` for one pose."""
    nan, bent = float("nan"), np.diag([1.0, 1, 2, 1])
    for call, place in (
        (lambda: robot.poses([nan, 0]), "joints[0]: the value of joint 'j'"),
        (lambda: robot.poses([[0, 0], [nan, 0]]), "joints[1, 0]: the value of joint 'j'"),
        (lambda: robot.poses({"j": nan}), "joints: the value of joint 'j'"),
        (lambda: robot.poses({"j": None}), "joints['j']: expected numbers, got None"),
        (lambda: robot.poses(base=bent), "base: the matrix"),
        (lambda: robot.poses(base=np.eye(4) * nan), "base: the pose"),
        (lambda: robot.poses(base=[np.eye(4), bent]), "base[1]: the matrix"),
    ):
        with pytest.raises(hullcast.InvalidArgument) as caught:
            call()
        assert f": {place}" in str(caught.value)


def test_a_list_of_rigid_transforms_is_a_base(robot):
    """Catches a list of transforms that `Scene` takes and `Robot.poses` refuses."""
    spatial = pytest.importorskip("scipy.spatial.transform")
    if not hasattr(spatial, "RigidTransform"):
        pytest.skip("this scipy has no RigidTransform")
    one = spatial.RigidTransform.from_translation([1.0, 2.0, 3.0])
    assert robot.poses(base=one).shape == (2, 4, 4)
    assert robot.poses(base=[one, one]).shape == (2, 2, 4, 4)
