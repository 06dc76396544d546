"""Pictures, checked by the number of things drawn."""

from __future__ import annotations

import numpy as np
import pytest
from crowds import CUBE, make_pile

import hullcast

pytest.importorskip("matplotlib")
pytest.importorskip("scipy")

from shapes import prism

from hullcast import _drawing


@pytest.fixture
def pile(client):
    """A scene of four bodies."""
    return make_pile(client)


def test_a_pile_is_drawn(client, pile, tmp_path):
    """Four bodies and a patch for each contact are drawn, and the file is an image."""
    m = client.query(pile, [[0, 1], [0, 2], [0, 3], [1, 2]], margin=0.02)
    assert m.point_counts.tolist() == [6, 4, 0, 0]
    figure = m.plot(path=tmp_path / "pile.png")
    assert (tmp_path / "pile.png").read_bytes()[1:4] == b"PNG"
    axes = figure.axes[0]
    kinds = [type(artist).__name__ for artist in axes.collections]
    assert kinds.count("Poly3DCollection") == 4 + 2
    assert axes.get_title() == "4 pairs, 10 contact points"
    assert [text.get_text() for text in axes.texts] == ["0", "1", "2", "3"]
    assert len(m.plot(pairs=[1]).axes[0].texts) == 2
    assert len(m.plot(pairs=[2]).axes) == 1  # no points, so there is no colour bar


def test_a_body_without_a_pose_is_left_out(client, pile):
    """A body with an unusable pose is left out; the others are drawn."""
    positions = pile.positions.copy()
    positions[2] = np.nan
    m = client.query(pile.moved(positions, pile.rotations), [[0, 1], [0, 2]], on_invalid="flag")
    assert [text.get_text() for text in m.plot().axes[0].texts] == ["0", "1"]


def test_only_real_edges_are_drawn():
    """A box has 12 edges and a hexagonal prism 18; the diagonals of their faces are not drawn."""
    assert len(_drawing.surface(CUBE)[1]) == 12
    assert len(_drawing.surface(prism(6, 0.5, 0.4).vertices)[1]) == 18


def test_poses_are_those_of_scipy():
    """The rotation by a quaternion agrees with scipy's."""
    from scipy.spatial.transform import Rotation

    turn = Rotation.from_quat(np.random.default_rng(91).normal(size=4))
    position = np.array([1.0, -2, 3])
    assert _drawing.world(CUBE, position, turn.as_quat()) == pytest.approx(
        turn.apply(CUBE) + position
    )


def test_what_cannot_be_drawn_says_so(client, pile, tmp_path):
    """Without a scene, the hulls' points or the outputs, the error names the missing part."""
    m = client.query(pile, [[0, 1]])
    m.save(tmp_path / "m.npz")
    with pytest.raises(hullcast.InvalidArgument, match="NO_SCENE"):
        hullcast.Manifolds.load(tmp_path / "m.npz").plot()
    ids = hullcast.Scene(list(pile.hull_ids), pile.positions, pile.rotations)
    with pytest.raises(hullcast.InvalidArgument, match="NO_GEOMETRY"):
        client.query(ids, [[0, 1]]).plot()
    with pytest.raises(hullcast.OutputNotAsked):
        client.query(pile, [[0, 1]], outputs=["ALPHA"]).plot()


def test_round_hulls_are_drawn(client):
    """Catches a hull without sharp edges, for which the newest matplotlib raises an error."""
    hulls = client.register([hullcast.sphere(1), hullcast.capsule(0.5, 1)])
    scene = hullcast.Scene(hulls, [[0, 0, 0], [0, 0, 1.9]], [[0, 0, 0, 1]] * 2)
    figure = client.query(scene, [[0, 1]], margin=0.1).plot()
    assert figure.axes[0].get_title().startswith("1 pair, ")
    assert figure._repr_png_()[1:4] == b"PNG"


def test_a_scene_is_drawn_without_contacts(pile, tmp_path):
    """Catches a scene that can only be drawn with results, and an unusable pose that raises."""
    figure = pile.plot(path=tmp_path / "scene.png")
    assert figure.axes[0].get_title() == "4 bodies"
    assert (tmp_path / "scene.png").read_bytes() == figure._repr_png_()
    positions = pile.positions.copy()
    positions[1] = np.inf
    assert pile.moved(positions, pile.rotations).plot().axes[0].get_title() == "3 bodies"


def test_axes_of_the_callers(client, pile):
    """Catches a new figure in spite of given axes, and flat axes that fail without a message."""
    from matplotlib.figure import Figure

    figure = Figure()
    axes = figure.add_subplot(1, 2, 2, projection="3d")
    m = client.query(pile, [[0, 1]], margin=0.02)
    assert m.plot(ax=axes) is figure
    assert len(axes.collections) > 4
    assert pile.plot(ax=axes) is figure
    for wrong in (figure.add_subplot(1, 2, 1), figure, 5, "ax"):
        with pytest.raises(hullcast.InvalidArgument, match="ax: expected matplotlib axes"):
            m.plot(ax=wrong)


def test_the_colour_bar_leaves_the_callers_axes_their_width(client, pile):
    """Catches a bar beside the axes that halves them, and covers the name of z or the next axes."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8, 4))
    FigureCanvasAgg(figure)
    left, right = (figure.add_subplot(1, 2, i, projection="3d") for i in (1, 2))
    client.query(pile, [[0, 1], [0, 2]], margin=0.02).plot(ax=left)
    pile.plot(ax=right)
    figure.canvas.draw()
    (bar,) = [axes for axes in figure.axes if axes not in (left, right)]
    assert left.get_position().width > 0.9 * right.get_position().width
    extent = bar.get_tightbbox()
    assert not extent.overlaps(right.get_tightbbox())
    for axis in (left.xaxis, left.yaxis, left.zaxis):
        assert not extent.overlaps(axis.label.get_window_extent())


def test_a_figure_is_pickled(pile):
    """Catches a figure that a process pool cannot return."""
    import pickle

    assert len(pickle.loads(pickle.dumps(pile.plot())).axes) == 1
