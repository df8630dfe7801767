"""glTF files whose meshes are called after parts open with these parts."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from model.core.errors import InputFileError
from model.core.names import MOST_NAMED, named_parts
from model.io.open_asset import open_asset, read_part_files


def glb(path: Path, *names: str) -> Path:
    scene = trimesh.Scene()
    for i, name in enumerate(names):
        at = trimesh.transformations.translation_matrix((1.5 * i, 0, 0))
        scene.add_geometry(
            trimesh.creation.box((1, 1, 1)), node_name=name, geom_name=f"g{i}", transform=at
        )
    path.write_bytes(scene.export(file_type="glb"))
    return path


def test_the_base_is_part_0_and_the_others_follow_in_order(tmp_path: Path) -> None:
    asset = open_asset(glb(tmp_path / "cab.glb", "door_left", "Cabinet Body", "drawer\x07"))
    assert asset.part_names == ("Cabinet Body", "door_left", "drawer")
    assert asset.element_part is not None and asset.tree is None
    assert asset.element_part.tolist() == [1] * 12 + [0] * 12 + [2] * 12
    assert asset.mesh is not None
    x = asset.mesh.triangles[..., 0].mean(1)
    assert [round(float(x[asset.element_part == i].mean()), 3) for i in range(3)] == [1.5, 0, 3]


@pytest.mark.parametrize(
    "names", [("Object_1", "Object_2"), ("wood", "glass"), ("door",), ("body", "frame")]
)
def test_other_names_may_be_materials(tmp_path: Path, names: tuple[str, ...]) -> None:
    path = glb(tmp_path / "cab.glb", *names)
    asset = open_asset(path)
    assert asset.element_part is None and asset.part_names == ()
    with pytest.raises(InputFileError, match="doesn't tell its parts"):
        read_part_files(path)


def test_where_all_move_none_is_the_base() -> None:
    assert named_parts(("door", "drawer")) == (1, 2)
    assert named_parts(("door", "body", "drawer")) == (1, 0, 2)
    assert named_parts(("body", *["door"] * MOST_NAMED)) is None


def test_its_parts_can_be_predicted_without_the_app(tmp_path: Path) -> None:
    declared = read_part_files(glb(tmp_path / "cab.glb", "body", "door"))
    assert [(p.link, p.name) for p in declared.parts] == [("link_0", "body"), ("link_1", "door")]
    assert declared.name == "cab" and not np.allclose(
        declared.parts[0].bounds, declared.parts[1].bounds
    )
