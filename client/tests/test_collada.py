"""COLLADA files: units, nodes, instances and primitives, compared with triangles given here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from solids import canonical

import hullcast
from hullcast import _mesh

TETRA = np.array([[0, 0, 0], [0, 2, 0], [1, 0, 0], [0, 0, 3]], dtype=float)
SIDES = [[0, 1, 2], [0, 2, 3], [0, 3, 1], [1, 3, 2]]
TRIANGLES = TETRA[SIDES]

POSITIONS = (
    '<source id="p"><float_array id="pa" count="12">0 0 0 0 2 0 1 0 0 0 0 3</float_array>'
    '<technique_common><accessor source="#pa" count="4" stride="3"><param name="X" type="float"/>'
    '<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common>'
    '</source><vertices id="v"><input semantic="POSITION" source="#p"/></vertices>'
)
VERTEX = '<input semantic="VERTEX" source="#v" offset="0"/>'
PRIMITIVE = f'<triangles count="4">{VERTEX}<p>0 1 2 0 2 3 0 3 1 1 3 2</p></triangles>'
INSTANCE = '<instance_geometry url="#g"/>'
NODES = f"<node>{INSTANCE}</node>"
SCENE = '<scene><instance_visual_scene url="#s"/></scene>'


def document(
    *,
    asset: str = "",
    positions: str = POSITIONS,
    primitives: str = PRIMITIVE,
    geometries: str = "",
    library: str = "",
    nodes: str = NODES,
    scene: str = SCENE,
    version: str = "2005/11",
) -> str:
    """A COLLADA file with one geometry `g`."""
    return (
        '<?xml version="1.0" encoding="utf-8"?>\n'
        f'<COLLADA xmlns="http://www.collada.org/{version}/COLLADASchema" version="1.4.1">'
        f'<asset>{asset}</asset><library_geometries><geometry id="g"><mesh>{positions}{primitives}'
        f"</mesh></geometry>{geometries}</library_geometries>{library}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        f"{scene}</COLLADA>"
    )


def load(folder: Path, text: str) -> _mesh.Mesh:
    """Writes the text to a file and reads its mesh."""
    (folder / "a.dae").write_text(text)
    return _mesh.load(folder / "a.dae")


def read(folder: Path, text: str) -> np.ndarray:
    """(m, 3, 3): the triangles that are read from the text."""
    mesh = load(folder, text)
    return mesh.vertices[mesh.faces]


def same(found: np.ndarray, expected: np.ndarray) -> bool:
    """Whether both have the same triangles, to rounding."""
    return canonical(np.round(found, 9) + 0.0) == canonical(np.round(expected, 9) + 0.0)


@pytest.mark.parametrize(
    ("asset", "meters"),
    [
        ("", 1.0),
        ('<unit name="meter" meter="1"/>', 1.0),
        ('<unit name="centimeter" meter="0.01"/>', 0.01),
        ('<unit meter="2.54e-2" name="inch"/><up_axis>Z_UP</up_axis>', 0.0254),
        ("<unit/>", 1.0),
        ("<up_axis>Y_UP</up_axis>", 1.0),
        ("<up_axis>X_UP</up_axis>", 1.0),
    ],
)
def test_the_unit_and_the_axes_of_a_file(tmp_path, asset, meters):
    """Catches lengths in a file's unit that are mistaken for metres.

    Axes stay as they are written, because robot software does not convert them either.
    """
    assert same(read(tmp_path, document(asset=asset)), TRIANGLES * meters)


def test_a_file_in_centimetres(client, tmp_path):
    """Catches a hull or robot a hundred times too large, from a file in centimetres."""
    (tmp_path / "a.dae").write_text(document(asset='<unit name="centimeter" meter="0.01"/>'))
    (tmp_path / "a.urdf").write_text(
        '<robot name="r"><link name="a"><collision><geometry><mesh filename="a.dae"/></geometry>'
        "</collision></link></robot>"
    )
    robot = hullcast.Robot(tmp_path / "a.urdf")
    for hull in client.register([tmp_path / "a.dae", *robot.shapes]):
        assert hull.volume == pytest.approx(1e-6)
        assert hull.vertices.max(axis=0) == pytest.approx([0.01, 0.02, 0.03])


def moved(x: float, y: float, z: float) -> np.ndarray:
    """The tetrahedron, translated."""
    return TRIANGLES + np.array([x, y, z])


def rotation(axis: int, degrees: float) -> np.ndarray:
    """A rotation about a coordinate axis, as a (3, 3) matrix."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    turn = np.eye(3)
    turn[[i, j, i, j], [i, j, j, i]] = [c, c, -s, s]
    return turn


SHEAR = np.array([[1, 0.5, 0, 7], [0, 2, 0, 8], [0, 0.25, -1, 9], [0, 0, 0, 1]])


@pytest.mark.parametrize(
    ("nodes", "expected"),
    [
        (f"<node><translate>1 2 3</translate>{INSTANCE}</node>", moved(1, 2, 3)),
        (f"<node><scale>2 3 -4</scale>{INSTANCE}</node>", TRIANGLES * [2, 3, -4]),
        (f"<node><rotate>0 0 2 90</rotate>{INSTANCE}</node>", TRIANGLES @ rotation(2, 90).T),
        (
            f"<node><matrix>{' '.join(map(str, SHEAR.ravel()))}</matrix>{INSTANCE}</node>",
            TRIANGLES @ SHEAR[:3, :3].T + SHEAR[:3, 3],
        ),
        (
            f'<node><translate sid="t">1 0 0</translate><rotate>1 0 0 30</rotate>'
            f"<scale>2 2 2</scale>{INSTANCE}</node>",
            TRIANGLES * 2 @ rotation(0, 30).T + [1, 0, 0],
        ),
        (
            f"<node><rotate>0 1 0 90</rotate><node><translate>5 0 0</translate>{INSTANCE}</node>"
            "</node>",
            moved(5, 0, 0) @ rotation(1, 90).T,
        ),
        (
            f"<node><lookat>1 2 3 1 2 8 0 1 0</lookat>{INSTANCE}</node>",
            TRIANGLES @ rotation(1, 180).T + [1, 2, 3],
        ),
        (
            f"<node>{INSTANCE}<node><translate>0 0 9</translate>{INSTANCE}</node></node>"
            f"<node><translate>9 0 0</translate>{INSTANCE}</node>",
            np.concatenate([TRIANGLES, moved(0, 0, 9), moved(9, 0, 0)]),
        ),
        (
            '<node><translate>1 0 0</translate><instance_node url="#part"/></node>'
            '<node><instance_node url="#part"/><instance_camera url="#c"/></node>',
            np.concatenate([moved(1, 4, 0), moved(0, 4, 0)]),
        ),
    ],
    ids=[
        "translate",
        "scale and mirror",
        "rotate",
        "matrix",
        "transforms in order",
        "nodes within nodes",
        "lookat",
        "several instances",
        "instances of a node",
    ],
)
def test_nodes(tmp_path, nodes, expected):
    """Catches transforms that are left out or applied in another order."""
    library = (
        f'<library_nodes><node id="part"><translate>0 4 0</translate>{INSTANCE}</node>'
        "</library_nodes>"
    )
    assert same(read(tmp_path, document(nodes=nodes, library=library)), expected)


def test_the_unit_scales_transforms_too(tmp_path):
    """Catches a translation that is taken in metres when the coordinates are in centimetres."""
    nodes = f"<node><translate>100 0 0</translate>{INSTANCE}</node>"
    text = document(asset='<unit meter="0.01"/>', nodes=nodes)
    assert same(read(tmp_path, text), TRIANGLES * 0.01 + [1, 0, 0])


TWO = f'{VERTEX}<input semantic="NORMAL" source="#n" offset="1"/>'


@pytest.mark.parametrize(
    ("primitives", "expected"),
    [
        (
            f'<triangles count="4">{TWO}<p>0 9 1 9 2 9 0 9 2 9 3 9 0 9 3 9 1 9 1 9 3 9 2 9</p>'
            "</triangles>",
            TRIANGLES,
        ),
        (
            '<triangles count="4"><input semantic="NORMAL" source="#n" offset="0"/>'
            '<input semantic="TEXCOORD" source="#t" offset="0" set="1"/>'
            '<input semantic="VERTEX" source="#v" offset="1"/>'
            "<p>9 0 9 1 9 2 9 0 9 2 9 3 9 0 9 3 9 1 9 1 9 3 9 2</p></triangles>",
            TRIANGLES,
        ),
        (
            f'<polylist count="4">{VERTEX}<vcount>3 3 3 3</vcount>'
            "<p>0 1 2 0 2 3 0 3 1 1 3 2</p></polylist>",
            TRIANGLES,
        ),
        (
            f'<polygons count="4">{VERTEX}<p>0 1 2</p><p>0 2 3</p><p>0 3 1</p><p>1 3 2</p>'
            "</polygons>",
            TRIANGLES,
        ),
        (
            f'<tristrips count="2">{VERTEX}<p>0 1 2 3</p><p>3 0 1</p></tristrips>',
            TETRA[[[0, 1, 2], [2, 1, 3], [3, 0, 1]]],
        ),
        (f'<trifans count="1">{VERTEX}<p>0 1 2 3</p></trifans>', TETRA[[[0, 1, 2], [0, 2, 3]]]),
        (
            f'<lines count="1">{VERTEX}<p>0 1</p></lines>'
            f'<triangles count="2" material="red">{VERTEX}<p>0 1 2 0 2 3</p></triangles>'
            f'<polylist count="2">{VERTEX}<vcount>3 3</vcount><p>0 3 1 1 3 2</p></polylist>'
            f'<triangles count="0">{VERTEX}</triangles><extra/>',
            TRIANGLES,
        ),
    ],
    ids=[
        "a normal per corner",
        "offsets that share",
        "polylist",
        "polygons",
        "tristrips",
        "trifans",
        "several primitives",
    ],
)
def test_primitives(tmp_path, primitives, expected):
    """Catches a stride, an offset or a kind of primitive that is read wrongly."""
    assert same(read(tmp_path, document(primitives=primitives)), expected)


def test_polygons_of_many_corners(tmp_path):
    """Catches quads that are read as triangles.

    A polylist of a quad and a triangle must keep its corners and its area.
    """
    primitive = f'<polylist count="2">{VERTEX}<vcount>4 3</vcount><p>0 2 1 3 0 1 2</p></polylist>'
    square = POSITIONS.replace("0 0 0 0 2 0 1 0 0 0 0 3", "0 0 0 1 1 0 1 0 0 0 1 0")
    found = read(tmp_path, document(positions=square, primitives=primitive))
    assert len(found) == 3
    areas = np.cross(found[:, 1] - found[:, 0], found[:, 2] - found[:, 0])[:, 2] / 2
    assert np.sort(areas) == pytest.approx([-0.5, 0.5, 0.5])


@pytest.mark.parametrize(
    "positions",
    [
        POSITIONS.replace("0 0 0 0 2 0 1 0 0 0 0 3", "8 9 0 0 0 7 0 2 0 7 1 0 0 7 0 0 3 7").replace(
            'count="4" stride="3"', 'count="4" stride="4" offset="2"'
        ),
        POSITIONS.replace("0 0 0 0 2 0 1 0 0 0 0 3", "7 0 0 0 7 0 2 0 7 1 0 0 7 0 0 3")
        .replace('stride="3"', 'stride="4"')
        .replace('<param name="X"', '<param type="float"/><param name="X"'),
        POSITIONS.replace("</source>", "<technique/></source>"),
    ],
    ids=["offset and stride", "a parameter without a name", "extra"],
)
def test_accessors(tmp_path, positions):
    """Catches an ignored accessor: positions that are read from the start of the array."""
    assert same(read(tmp_path, document(positions=positions)), TRIANGLES)


def test_several_geometries_and_versions(tmp_path):
    """Catches that geometries after the first are lost, or that another namespace is not read."""
    other = POSITIONS.replace('"p', '"q').replace("#p", "#q").replace('"v"', '"w"')
    other = other.replace("0 0 0 0 2 0 1 0 0 0 0 3", "0 0 0 0 4 0 2 0 0 0 0 6")
    geometries = (
        f'<geometry id="h"><mesh>{other}{PRIMITIVE.replace("#v", "#w")}</mesh></geometry>'
        '<geometry id="unused"><spline/></geometry>'
    )
    nodes = f'{NODES}<node><instance_geometry url="#h"/></node>'
    for version in ("2005/11", "2008/03"):
        text = document(geometries=geometries, nodes=nodes, version=version)
        assert same(read(tmp_path, text), np.concatenate([TRIANGLES, TRIANGLES * 2]))
    assert same(read(tmp_path, document().replace(' xmlns="', ' other="')), TRIANGLES)


@pytest.mark.parametrize(
    ("text", "reason", "named"),
    [
        (document(scene=""), "UNSUPPORTED_MESH", "no <scene>"),
        (
            document(nodes='<node name="n"><instance_controller url="#k"/></node>'),
            "UNSUPPORTED_MESH",
            "the node 'n' has a skin or a morph",
        ),
        (
            document(nodes=f'<node id="n"><skew>45 1 0 0 0 1 0</skew>{INSTANCE}</node>'),
            "UNSUPPORTED_MESH",
            "<skew> of the node 'n'",
        ),
        (
            document(nodes='<node><instance_geometry url="other.dae#g"/></node>'),
            "UNSUPPORTED_MESH",
            "another file, 'other.dae#g'",
        ),
        (
            document(
                geometries='<geometry id="h"><spline/></geometry>',
                nodes='<node><instance_geometry url="#h"/></node>',
            ),
            "UNSUPPORTED_MESH",
            "the geometry 'h' is a <spline>",
        ),
        (
            document(primitives=f"<polygons>{VERTEX}<ph><p>0 1 2</p><h>0</h></ph></polygons>"),
            "UNSUPPORTED_MESH",
            "a polygon with a hole",
        ),
        (document(primitives="<brep/>"), "UNSUPPORTED_MESH", "<brep> of the geometry 'g'"),
        (
            document(nodes='<node id="n"><instance_node url="#n"/></node>'),
            "MALFORMED_MESH",
            "the node 'n' contains itself",
        ),
        (
            document(nodes='<node><instance_geometry url="#none"/></node>'),
            "MALFORMED_MESH",
            "no <geometry> has the id '#none'",
        ),
        (document(primitives=PRIMITIVE.replace("#v", "#p")), "MALFORMED_MESH", "no <vertices>"),
        (
            document(primitives=PRIMITIVE.replace("3 2<", "4 2<")),
            "MALFORMED_MESH",
            "vertex 4, but its 4 vertices are numbered from 0",
        ),
        (
            document(primitives=PRIMITIVE.replace("3 2<", "3<")),
            "MALFORMED_MESH",
            "within a triangle",
        ),
        (document(primitives=PRIMITIVE.replace("3 2<", "-1 2<")), "MALFORMED_MESH", "'-1'"),
        (document(primitives=PRIMITIVE.replace(VERTEX, "")), "MALFORMED_MESH", "no input VERTEX"),
        (
            document(primitives=f"<polylist>{VERTEX}<vcount>3</vcount><p>0 1 2 3</p></polylist>"),
            "MALFORMED_MESH",
            "has 4 indices, not 3",
        ),
        (document(positions=POSITIONS.replace("0 0 3<", "0 0<")), "MALFORMED_MESH", "end before"),
        (document(positions=POSITIONS.replace("0 0 3<", "0 0 x<")), "MALFORMED_MESH", "'x'"),
        (
            document(positions=POSITIONS.replace('<param name="Z" type="float"/>', "")),
            "UNSUPPORTED_MESH",
            "2 coordinates",
        ),
        (document(asset='<unit meter="0"/>'), "MALFORMED_MESH", "<unit meter>"),
        (document(asset='<unit meter="cm"/>'), "MALFORMED_MESH", "<unit meter>: 'cm'"),
        (
            document(nodes=f"<node><matrix>1 0 0</matrix>{INSTANCE}</node>"),
            "MALFORMED_MESH",
            "<matrix> has 3 numbers, not 16",
        ),
        *(
            (
                document(
                    nodes=f"<node><matrix>1 0 0 {x} 0 1 0 0 0 0 1 0 {last}</matrix>{INSTANCE}</node>"
                ),
                "UNSUPPORTED_MESH",
                f"<matrix> has the last row {last}, expected 0 0 0 1",
            )
            for x, last in ((0, "5 6 7 1"), (3, "0 0 0 2"), (3, "0 0 0.1 1"), (0, "0 0 0 0"))
        ),
        (
            document(nodes=f"<node><rotate>0 0 0 9</rotate>{INSTANCE}</node>"),
            "MALFORMED_MESH",
            "<rotate> has no axis",
        ),
        (document()[:-20], "MALFORMED_MESH", "not XML"),
        ("<mesh/>", "MALFORMED_MESH", "the root element is <mesh>"),
        (document(nodes=""), "NO_TRIANGLES", "no triangles"),
    ],
)
def test_files_that_are_refused(tmp_path, text, reason, named):
    """Catches geometry that is silently left out or misplaced."""
    with pytest.raises(hullcast.InvalidArgument) as caught:
        load(tmp_path, text)
    assert caught.value.reason == reason
    assert named in caught.value.message
    assert "a.dae" in caught.value.message


def test_nodes_that_multiply(tmp_path):
    """Catches a hang: 40 nodes, each with two instances of the next, expand to 2^40 geometries."""
    library = "".join(
        f'<node id="n{i}">{2 * f"""<instance_node url="#n{i + 1}"/>"""}</node>' for i in range(40)
    )
    library = f'<library_nodes>{library}<node id="n40">{INSTANCE}</node></library_nodes>'
    text = document(nodes='<node><instance_node url="#n0"/></node>', library=library)
    with pytest.raises(hullcast.InvalidArgument, match="more than 100000 nodes"):
        load(tmp_path, text)
