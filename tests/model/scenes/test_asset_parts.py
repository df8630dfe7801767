"""Which parts an asset tells by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.geometry.readers import read_asset
from model.scenes.asset_parts import known_parts
from tests.model.scenes import scenes_made as made


def gltf(path: Path, names: tuple[str, ...]) -> Path:
    """The cabinet, 11 boards in all; each of its parts a node, moved and nested."""
    scene = trimesh.Scene()
    lift = trimesh.transformations.translation_matrix((0.5, 1.0, 0.0))
    scene.graph.update(frame_to="wrapper", frame_from="world", matrix=lift)
    for name, mesh in zip(names, made.cabinet_parts().values(), strict=True):
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        scene.add_geometry(
            solid, node_name=name, geom_name=f"m {name}", parent_node_name="wrapper",
            transform=np.diag([1.0, -2.0, 1.0, 1.0]),
        )  # fmt: skip
    path.write_bytes(scene.export(file_type="glb"))
    return path


def test_meshes_that_are_called_after_parts_are_parts(tmp_path: Path) -> None:
    path = gltf(tmp_path / "cab.glb", ("Body", "door_left", "Drawer.001"))
    found = known_parts(path)
    assert {p.name: len(p.mesh.faces) for p in found.parts if p.mesh is not None} == {
        "Body": 72, "door_left": 24, "Drawer.001": 48,
    }  # fmt: skip
    assert found.parts[0].link == "link_0" and found.how == "its named meshes"
    whole = read_asset(path).bounds
    assert np.allclose(np.min([p.bounds[0] for p in found.parts], axis=0), whole[0], atol=1e-6)
    assert np.allclose(np.max([p.bounds[1] for p in found.parts], axis=0), whole[1], atol=1e-6)


@pytest.mark.parametrize("names", [("Object_1", "Object_2", "Object_3"), ("wood", "glass", "1")])
def test_meshes_without_such_a_name_may_be_materials(tmp_path: Path, names: tuple) -> None:
    assert known_parts(gltf(tmp_path / "cab.glb", names)).how == "its connected pieces"
