"""Collision shapes that a URDF tells: what is taken of them, and what is told of bad ones."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.shapes import Primitive, Solid, hull_of_shape
from model.io.asset_cache import load_asset, save_asset
from model.io.assets.reader import load_object, reading_notes
from model.io.open_asset import open_asset

VISUAL = '<visual><geometry><mesh filename="{}.ply"/></geometry></visual>'
JOINT = """<joint name="hinge" type="revolute"><origin xyz="1 0 0" rpy="0 0 1.5707963267948966"/>
<axis xyz="0 0 1"/><parent link="body"/><child link="door"/><limit lower="0" upper="1"/></joint>"""


def collision(geometry: str, at: str = "0 0 0") -> str:
    return f'<collision><origin xyz="{at}"/><geometry>{geometry}</geometry></collision>'


@pytest.fixture
def urdf(tmp_path: Path):
    """Writes a URDF of a body and a door, with the given elements in them."""
    trimesh.creation.box(extents=(2, 2, 1)).export(tmp_path / "body.ply")
    trimesh.creation.box(extents=(1, 0.1, 1)).export(tmp_path / "door.ply")
    path = tmp_path / "r.urdf"

    def write(body: str = "", door: str = "", more: str = "") -> Path:
        body, door = VISUAL.format("body") + body, VISUAL.format("door") + door
        links = f'<link name="body">{body}</link><link name="door">{door}</link>'
        path.write_text(f'<robot name="r">{links}{JOINT}{more}</robot>')
        return path

    return write


def test_primitives_stay_primitives_in_the_objects_frame(urdf) -> None:
    kinds = {
        'box size="1 0.1 1"': (1, 0.1, 1),
        'cylinder radius="0.1" length="0.4"': (0.1, 0.4),
        'sphere radius="0.2"': (0.2,),
        'capsule radius="0.1" length="0.3"': (0.1, 0.3),
    }
    obj = load_object(urdf(door="".join(collision(f"<{kind}/>", "0.5 0 0") for kind in kinds)))
    assert set(obj.shapes) == {"door"}, "of the body nothing is told"
    for shape, (kind, sizes) in zip(obj.shapes["door"], kinds.items(), strict=True):
        assert isinstance(shape, Primitive)
        assert (shape.kind, shape.sizes) == (kind.split()[0], sizes)
        assert shape.object_from_shape[:3, 3] == pytest.approx([1, 0.5, 0])
    assert np.ptp(hull_of_shape(obj.shapes["door"][0]).bounds, axis=0) == pytest.approx([0.1, 1, 1])


def test_a_mesh_is_kept_with_its_scale_and_convex_pieces_apart(urdf, tmp_path: Path) -> None:
    ring = [[0, 0], [9, 0], [9, 1], [1, 1], [1, 9], [0, 9]]
    vertices = [[x, y, z] for z in (0, 1) for x, y in ring]
    top = [[6, 7, 8], [6, 8, 9], [6, 9, 10], [6, 10, 11]]
    sides = [f for i in range(6) for j in [(i + 1) % 6] for f in ([i, j, j + 6], [i, j + 6, i + 6])]
    faces = [[a - 6, c - 6, b - 6] for a, b, c in top] + top + sides
    ell = trimesh.Trimesh(vertices, faces)
    assert ell.is_watertight and ell.volume == pytest.approx(17)
    ell.export(tmp_path / "ell.stl")
    two = [trimesh.creation.box(bounds=[[x, 0, 0], [x + 1, 1, 1]]) for x in (0, 5)]
    trimesh.util.concatenate(two).export(tmp_path / "two.obj")
    path = urdf(
        collision('<mesh filename="ell.stl" scale="0.1 0.1 -0.1"/>', "0 0 2"),
        collision('<mesh filename="two.obj"/>'),
    )
    obj = load_object(path)
    (kept,) = obj.shapes["body"]
    assert isinstance(kept, Solid) and len(kept.faces) == len(ell.faces)
    assert kept.vertices.min(axis=0) == pytest.approx([0, 0, 1.9])
    assert kept.vertices.max(axis=0) == pytest.approx([0.9, 0.9, 2])
    made = trimesh.Trimesh(kept.vertices, kept.faces)
    assert made.volume == pytest.approx(0.017), "mirrored, its faces look outwards still"
    assert [round(hull_of_shape(s).volume, 6) for s in obj.shapes["door"]] == [1, 1]


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        (collision('<box size="0 1 1"/>'), "sizes above 0"),
        (collision('<box size="nan 1 1"/>'), "finite"),
        (collision('<sphere radius="x"/>'), "not a number"),
        (collision('<mesh filename="gone.stl"/>'), "isn't there"),
        (collision('<mesh filename="../../etc/x.stl"/>'), "outside"),
        (collision('<mesh filename="bad.stl"/>'), "bad.stl"),
        (collision('<mesh filename="flat.ply"/>'), "no volume"),
        (collision('<mesh filename="body.ply" scale="1 1 0"/>'), "no volume"),
        (collision('<box size="1 1 1"/>', "0 nan 0"), "finite"),
        (collision('<plane normal="0 0 1"/>'), "none of mesh"),
        ("<collision/>", "no geometry"),
    ],
)
def test_a_bad_one_is_told_and_the_links_are_not_taken(
    urdf, wrong: str, said: str, tmp_path: Path
) -> None:
    (tmp_path / "bad.stl").write_bytes(b"solid no")
    trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0]], [[0, 1, 2], [1, 3, 2]]).export(
        tmp_path / "flat.ply"
    )
    good = collision('<box size="1 0.1 1"/>')
    path = urdf(good, good + wrong)
    obj = load_object(path)
    assert set(obj.shapes) == {"body"}
    (note,) = reading_notes(path, obj)
    assert said in note and "link 'door'" in note and "not taken" in note
    asset = open_asset(path)
    assert set(asset.shapes) == {"link_0"} and note in asset.warnings


def test_the_visuals_mesh_once_more_tells_nothing(urdf) -> None:
    again = collision('<mesh filename="door.ply"/>')
    assert not load_object(urdf(door=again)).shapes
    moved = collision('<mesh filename="door.ply"/>', "0 0 0.1")
    assert set(load_object(urdf(door=moved)).shapes) == {"door"}


def test_what_is_fixed_together_collides_together(urdf, tmp_path: Path) -> None:
    more = """<link name="grip"><collision><geometry><sphere radius="0.2"/></geometry></collision>
    </link><joint name="bolt" type="fixed"><origin xyz="0 0 3"/><parent link="door"/>
    <child link="grip"/></joint>"""
    again = collision('<mesh filename="door.ply"/>')
    for unit in (1.0, 0.5):
        asset = open_asset(urdf(door=again, more=more), unit_scale=unit)
        mesh, sphere = asset.shapes["link_1"]
        assert isinstance(mesh, Solid) and isinstance(sphere, Primitive)
        assert sphere.sizes == pytest.approx((0.2 * unit,))
        assert sphere.object_from_shape[:3, 3] == pytest.approx([unit, 0, 3 * unit])
        assert np.ptp(mesh.vertices, axis=0) == pytest.approx([0.1 * unit, unit, unit])
    save_asset(asset, tmp_path / "copy")
    kept, one = load_asset(tmp_path / "copy").shapes["link_1"]
    assert isinstance(kept, Solid) and (kept.vertices == mesh.vertices).all()
    assert isinstance(one, Primitive) and one.kind == "sphere"


def test_where_nothing_is_seen_the_shapes_are_both(tmp_path: Path) -> None:
    path = tmp_path / "r.urdf"
    box = '<box size="1 1 1"/>'
    boxes = (
        f'<link name="{n}">{collision(box, at)}</link>'
        for n, at in (("body", "0 0 0"), ("door", "1.5 0 0"))
    )
    path.write_text(f'<robot name="r">{"".join(boxes)}{JOINT}</robot>')
    assert set(load_object(path).shapes) == {"body", "door"}
