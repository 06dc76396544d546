"""Other forms of results: some pairs, one body's contacts, dense arrays, data frames, files."""

from __future__ import annotations

import pickle
import sys
import types

import numpy as np
import pytest
from crowds import CUBE, EVERYTHING, crowd, expect_same

import hullcast
from hullcast import Flag, Manifolds, Outcome


@pytest.fixture(scope="module")
def scene(client):
    return crowd(client, 60)


@pytest.fixture(scope="module")
def some(client, scene):
    """All pairs of a small crowd, some of them in contact."""
    pairs = [[i, j] for i in range(60) for j in range(60) if (i + j) % 2 or i <= j]
    m = client.query(scene, pairs, margin=0.05, outputs=EVERYTHING)
    assert np.count_nonzero(m.point_counts) > 100
    assert np.count_nonzero(m.point_counts == 0) > 100
    return m


def test_some_pairs_are_those_pairs_asked_alone(client, scene, some):
    """Slices, masks and indices select pairs together with their points."""
    chosen = np.random.default_rng(71).permutation(len(some))[:200]
    alone = client.query(scene, some.pairs[chosen], margin=0.05, outputs=EVERYTHING)
    expect_same(some[chosen], alone)
    expect_same(some[chosen.tolist()], alone)
    mask = np.isin(np.arange(len(some)), chosen)
    expect_same(some[mask], some[np.sort(chosen)])
    expect_same(some[10:50:3], some[np.arange(10, 50, 3)])
    assert len(some[0:0]) == 0
    assert some[-1].bodies == tuple(some.pairs[-1])
    with pytest.raises(IndexError):
        some[[len(some)]]


def test_contacts_of_a_body_are_seen_from_it(client, scene, some):
    """The pairs of a body are turned such that it is A, with the numbers of the swapped query."""
    body = int(np.bincount(some.pairs[some.point_counts > 0].reshape(-1)).argmax())
    for wrong in (-1, len(scene), 0.5, "a", None, [0, 1]):
        with pytest.raises(hullcast.InvalidArgument, match="body"):
            some.contacts_of(wrong)
    mine = some.contacts_of(body)
    rows = np.flatnonzero((some.pairs == body).any(axis=1) & (some.point_counts > 0))
    assert (mine.pairs[:, 0] == body).all()
    assert np.count_nonzero(some.pairs[rows, 0] != body) >= 3
    assert np.count_nonzero(some.pairs[rows, 0] == body) >= 3
    assert mine.separation.tobytes() == some.separation[rows].tobytes()
    asked = client.query(scene, mine.pairs, margin=0.05, outputs=EVERYTHING)
    compared = 0
    for ours, theirs in zip(mine, asked, strict=True):
        if Flag.COINCIDENT in theirs.flags:
            continue
        assert ours.normal == pytest.approx(theirs.normal, abs=1e-9)
        assert ours.feature_kinds == theirs.feature_kinds
        assert (ours.feature_indices == theirs.feature_indices).all()
        both = [m.point_ids.tolist() for m in (ours, theirs)]
        assert sorted(both[0]) == sorted(both[1])
        at = [both[1].index(entry) for entry in both[0]]
        assert ours.witness_a == pytest.approx(theirs.witness_a[at], abs=1e-9)
        assert ours.witness_b == pytest.approx(theirs.witness_b[at], abs=1e-9)
        compared += 1
    assert compared >= 6
    gap = mine.witness_b - mine.witness_a
    along = mine.distance[:, None] * np.repeat(mine.normal, mine.point_counts, axis=0)
    assert gap == pytest.approx(along, abs=1e-12)
    again = client.query(scene, mine.pairs, margin=0.05, outputs=EVERYTHING, warm=mine)
    assert again.alpha == pytest.approx(asked.alpha, rel=1e-12)


@pytest.mark.parametrize("k", [0, 1, 4, 30])
def test_padded_points_are_the_deepest(some, k):
    """Each slot agrees with a plain loop, and unused slots are as documented."""
    dense = some.padded(k)
    assert dense.mask.shape == (len(some), k)
    for i, one in enumerate(some):
        order = np.argsort(one.distance, kind="stable")[:k]
        used = len(order)
        assert dense.mask[i].tolist() == [True] * used + [False] * (k - used)
        assert (dense.distance[i, :used] == one.distance[order]).all()
        assert (dense.witness_a[i, :used] == one.witness_a[order]).all()
        assert (dense.witness_b[i, :used] == one.witness_b[order]).all()
        assert (dense.point_ids[i, :used] == one.point_ids[order]).all()
    assert np.isposinf(dense.distance[~dense.mask]).all()
    assert not dense.witness_a[~dense.mask].any()
    assert (dense.point_ids[~dense.mask] == 2**32 - 1).all()


def test_padding_needs_no_more_than_points(client, scene):
    """Arrays of outputs that were not requested are None, and `k` must not be negative."""
    m = client.query(scene, [[0, 1]], outputs=["POINTS"])
    assert m.padded(2).witness_b is None
    assert m.padded(2).point_ids is None
    with pytest.raises(hullcast.InvalidArgument, match="k"):
        m.padded(-1)
    with pytest.raises(hullcast.OutputNotAsked):
        client.query(scene, [[0, 1]], outputs=["ALPHA"]).padded(2)


def test_saved_and_loaded(client, scene, some, tmp_path):
    """Loaded results are equal bit for bit, and still lack the outputs that were not requested."""
    path = tmp_path / "answer"
    some.save(path)
    assert path.exists()  # under exactly the given name
    expect_same(Manifolds.load(path), some)
    few = client.query(scene, [[0, 1], [1, 2]], outputs=["ALPHA"])
    few.save(path)
    loaded = Manifolds.load(path)
    assert loaded.alpha.tobytes() == few.alpha.tobytes()
    with pytest.raises(hullcast.OutputNotAsked):
        _ = loaded.normal
    expect_same(pickle.loads(pickle.dumps(some)), some)


def test_other_files_are_not_loaded(some, tmp_path):
    """Files that are not npz, are not manifolds, or have a truncated column are refused."""
    path = tmp_path / "x.npz"
    path.write_bytes(b"nothing of the kind")
    np.save(tmp_path / "array.npy", np.zeros(3))
    with pytest.raises(hullcast.InvalidArgument, match="NOT_MANIFOLDS"):
        Manifolds.load(tmp_path / "array.npy")
    with pytest.raises(hullcast.InvalidArgument, match="NOT_MANIFOLDS"):
        Manifolds.load(path)
    np.savez(path, alphas=np.zeros(3))
    with pytest.raises(hullcast.InvalidArgument, match="NOT_MANIFOLDS"):
        Manifolds.load(path)
    some.save(path)
    with np.load(path) as file:
        columns = dict(file)
    columns["witness_as"] = columns["witness_as"][:-1]
    np.savez(path, **columns)
    with pytest.raises(hullcast.InvalidArgument, match="witness_as"):
        Manifolds.load(path)


def test_impossible_values_of_a_file_are_refused(some, tmp_path):
    """Values that no server may send are no answer in a file either: they loaded as a contact."""
    path = tmp_path / "x.npz"
    some.save(path)
    with np.load(path) as file:
        columns = dict(file)
    for name, value in [
        ("alphas", np.nan),
        ("alphas", -5.0),
        ("alpha_lowers", 99.0),
        ("alpha_uppers", -99.0),
        ("normals", 7.0),
        ("separations", np.inf),
        ("distances", np.nan),
        ("witness_as", np.nan),
        ("outcomes", 9),
    ]:
        changed = columns | {name: np.full_like(columns[name], value)}
        np.savez(path, **changed)
        with pytest.raises(hullcast.InvalidArgument, match=f"x.npz: .*{name[:5]}"):
            Manifolds.load(path)
    np.savez(path, **columns | {"point_counts": np.full(len(some), np.nan)})
    with pytest.raises(hullcast.InvalidArgument, match="point_counts has the type float64"):
        Manifolds.load(path)
    np.savez(path, **columns)
    expect_same(Manifolds.load(path), some)


def test_data_frames(client, scene, some):
    """Every column has its name, and points repeat the columns of their pair."""
    pytest.importorskip("pandas")
    pairs = some.to_dataframe("pairs")
    assert len(pairs) == len(some)
    assert (pairs["alpha"] == some.alpha).all()
    assert (pairs["body_b"] == some.pairs[:, 1]).all()
    assert (pairs["points"] == some.point_counts).all()
    contacts = (pairs["outcome"] == "CONTACT").to_numpy()
    assert (contacts == (some.outcome == Outcome.CONTACT)).all()
    points = some.to_dataframe()
    assert len(points) == len(some.distance)
    assert (points["distance"] == some.distance).all()
    assert (points["witness_b_z"] == some.witness_b[:, 2]).all()
    assert (points["point_id_b1"] == some.point_ids[:, 3]).all()
    assert (points["separation"] == np.repeat(some.separation, some.point_counts)).all()
    assert points.groupby("pair").size().sum() == len(some.distance)
    few = client.query(scene, [[0, 1]], outputs=["ALPHA"])
    expected = [
        "pair",
        "outcome",
        "flags",
        "body_a",
        "body_b",
        "alpha",
        "alpha_lower",
        "alpha_upper",
    ]
    assert set(few.to_dataframe("pairs").columns) == set(expected)
    with pytest.raises(hullcast.OutputNotAsked):
        few.to_dataframe()
    with pytest.raises(hullcast.InvalidArgument):
        few.to_dataframe("columns")


def test_categories_of_a_data_frame_are_the_names(some):
    """Catches a category "" that is no outcome, and so a row in every table of counts."""
    pairs = some.to_dataframe("pairs")
    assert list(pairs["outcome"].cat.categories) == [*Outcome.__members__]
    for outcome, name in zip(some.outcome, pairs["outcome"], strict=True):
        assert Outcome(int(outcome)).name == name
    for side, name in enumerate(("feature_kind_a", "feature_kind_b")):
        assert list(pairs[name].cat.categories) == [*hullcast.FeatureKind.__members__]
        kinds = [hullcast.FeatureKind(int(kind)).name for kind in some.feature_kinds[:, side]]
        assert pairs[name].tolist() == kinds


def test_a_recording_of_another_type_is_refused(some, monkeypatch):
    """Catches `log(recording=5)`, which wrote nothing and raised nothing."""
    library = types.ModuleType("rerun")
    library.RecordingStream = type("RecordingStream", (), {})
    monkeypatch.setitem(sys.modules, "rerun", library)
    for wrong in (5, "recording", True, object()):
        with pytest.raises(
            hullcast.InvalidArgument, match="WRONG_TYPE: recording: expected a rerun"
        ):
            some.log(recording=wrong)


def test_what_is_shown(client):
    """The texts of hulls, scenes and results are one line each."""
    (hull,) = client.register([CUBE])
    assert repr(hull) == (
        f"Hull({hull.id.hex()[:12]}: 8 vertices, 6 faces, radii 0.5 to 0.866, volume 1)"
    )
    scene = hullcast.Scene([hull], [[0, 0, 0], [0, 0, 0.9]], [[0, 0, 0, 1]] * 2, body_hulls=[0, 0])
    assert repr(scene) == "Scene(2 bodies of 1 hull)"
    m = client.query(scene, [[0, 1]])
    assert repr(m) == "Manifolds(1 pair: 1 CONTACT; 4 points)"
    unknown = hullcast.Scene([b"\7" * 32], [[0, 0, 0]], [[0, 0, 0, 1]], worlds=[3])
    assert repr(unknown) == "Scene(1 body of 1 hull in 1 world)"
    text = repr(client.query(unknown, [[0, 0]], outputs=["ALPHA"]))
    assert text.startswith("Manifolds(1 pair: 1 INVALID; flags <Flag.UNKNOWN_HULL")
