"""Light in vertex colors, and edges of plain meshes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.server.display_tasks import lit_mesh, lit_parts
from app.server.tasks import ReadOptions, working_copy
from model.core.geometry import Mesh
from model.geometry.ambient_light import crease_edges, is_plain, with_ambient_occlusion
from model.geometry.display import display_asset


def mesh_of(shape: trimesh.Trimesh) -> Mesh:
    return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int32))


def knob_on_a_panel() -> Mesh:
    panel = trimesh.creation.box((1.0, 1.0, 0.02))
    knob = trimesh.creation.cylinder(0.05, 0.06, sections=24)
    knob.apply_translation((0.0, 0.0, 0.04))
    return mesh_of(trimesh.util.concatenate([panel, knob]))


def test_a_panel_is_darker_round_a_knob_and_keeps_its_color_far_away() -> None:
    mesh = knob_on_a_panel()
    shaded, face = with_ambient_occlusion(mesh)
    assert shaded.face_areas.sum() == pytest.approx(mesh.face_areas.sum(), rel=1e-6)
    per_face = np.bincount(face, shaded.face_areas, len(mesh.faces))
    assert np.allclose(per_face, mesh.face_areas, rtol=1e-5), "each triangle knows its face"
    top = np.abs(shaded.vertices[:, 2] - 0.01) < 1e-6
    far = np.linalg.norm(shaded.vertices[:, :2], axis=1)
    level = shaded.vertex_colors[:, 0].astype(float)  # type: ignore[index]
    near_level = level[top & (far > 0.051) & (far < 0.08)].mean()
    far_level = level[top & (far > 0.3) & (far < 0.45)].mean()
    assert far_level > 195 and near_level < 0.9 * far_level


def test_faces_that_point_inwards_are_lit_as_well() -> None:
    mesh = knob_on_a_panel()
    inward = Mesh(mesh.vertices, mesh.faces[:, ::-1])
    a, b = (with_ambient_occlusion(m)[0].vertex_colors for m in (mesh, inward))
    assert a is not None and b is not None
    assert abs(float(a.mean()) - float(b.mean())) < 3


def test_edges_are_creases_whichever_way_faces_are_wound() -> None:
    box = mesh_of(trimesh.creation.box((1.0, 2.0, 3.0)))
    flipped = box.faces.copy()
    flipped[::3] = flipped[::3, ::-1]
    for mesh in (box, Mesh(box.vertices, flipped)):
        edges = crease_edges(mesh)
        lengths = np.linalg.norm(edges.points[:, 1] - edges.points[:, 0], axis=1)
        assert sorted(np.rint(lengths)) == [1] * 4 + [2] * 4 + [3] * 4, "no diagonals"
    ball = mesh_of(trimesh.creation.icosphere(3))
    assert not len(crease_edges(ball).points)
    square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float64)
    sheet = Mesh(square, np.array([(0, 1, 2), (0, 2, 3)], np.int32))
    assert len(crease_edges(sheet).points) == 4, "its rim"


def test_light_is_kept_beside_the_arrays_and_cut_with_the_parts(tmp_path: Path) -> None:
    trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / "box.ply")
    asset, folder = working_copy(tmp_path / "box.ply", tmp_path / "workspace", ReadOptions())
    shown = display_asset(asset).mesh
    assert shown is not None and is_plain(shown)
    assert lit_parts(folder, shown, np.zeros(12, np.int16)) is None, "not computed yet"
    lit = lit_mesh(folder)
    assert lit is not None and set(lit.glb_order) == set(range(12))
    (kept,) = folder.glob("light-*.npz")
    written = kept.stat().st_mtime_ns
    again = lit_mesh(folder)
    assert again is not None and again.glb == lit.glb and kept.stat().st_mtime_ns == written
    labels = np.array([0] * 5 + [1] * 7, np.int16)
    parts = lit_parts(folder, shown, labels)
    assert parts is not None
    assert parts[1].face_areas.sum() == pytest.approx(shown.face_areas[labels == 1].sum())
    kept.write_bytes(b"damaged")
    assert lit_parts(folder, shown, labels) is None
    assert lit_mesh(folder) is not None, "it is computed anew"


def test_what_has_colors_of_its_own_is_left_alone(tmp_path: Path) -> None:
    box = trimesh.creation.box((0.4, 0.3, 0.2))
    box.visual.vertex_colors = np.random.default_rng(0).integers(0, 255, (8, 4), np.uint8)
    box.export(tmp_path / "box.ply")
    _, folder = working_copy(tmp_path / "box.ply", tmp_path / "workspace", ReadOptions())
    assert lit_mesh(folder) is None and not list(folder.glob("light-*"))
