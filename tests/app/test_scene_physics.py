"""What the URDFs of a scene's objects tell stays with their working copies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from app.server import part_tasks, scene_tasks, tasks
from model.core.shapes import Primitive
from model.io.open_asset import open_asset
from model.scenes.scene import Decision, SceneObject
from tests.model.scenes.test_asset_parts import cupboard, robot

__all__ = ["cupboard"]


@pytest.mark.parametrize("size", [1.0, 1.5])
def test_masses_and_shapes_of_an_asset_stay_in_its_working_copy(
    cupboard: Path, tmp_path: Path, size: float
) -> None:
    shape = "<collision><geometry><sphere radius='0.03'/></geometry></collision>"
    text = robot(body=9.0, door=9.0, grip=0.2)
    (cupboard / "object.urdf").write_text(text.replace("<visual>", shape + "<visual>"))
    obj = SceneObject("a", "a", np.eye(4), np.full(3, size))
    copy, workspace = tmp_path / "copy", tmp_path / "workspace"
    item = scene_tasks.SceneItem(obj, Decision(True), cupboard, copy)
    done = scene_tasks.prepare(item, workspace, "default", "geometric")
    assert done.prediction is not None and done.prediction.tree is not None and done.labels
    _, folder = tasks.working_copy(copy, workspace, tasks.ReadOptions())
    source = part_tasks.PartSource(folder, workspace, done.labels, dict(done.names))
    made = part_tasks.articulated_object(source, done.prediction.tree)
    masses = {k: round(i.mass, 3) for k, i in made.inertials.items()}
    assert masses == ({"link_0": 9.0, "link_1": 9.2} if size == 1.0 else {})
    spheres = [s for held in made.shapes.values() for s in held]
    assert {k: len(held) for k, held in made.shapes.items()} == {"link_0": 1, "link_1": 2}
    assert all(isinstance(s, Primitive) and s.sizes == (0.03 * size,) for s in spheres)


def test_in_another_frame_they_are_turned_along_and_damage_is_nothing(
    cupboard: Path, tmp_path: Path
) -> None:
    (cupboard / "object.urdf").write_text(robot(body=9.0, door=9.0, grip=0.2))
    obj, copy = SceneObject("a", "a", np.eye(4), np.ones(3)), tmp_path / "copy"
    scene_tasks.make_working_copy(scene_tasks.SceneItem(obj, Decision(True), cupboard, copy))
    plain = open_asset(copy).inertials["link_1"]
    turned = open_asset(copy, up_axis="y", unit_scale=0.5).inertials["link_1"]
    x, y, z = plain.center
    assert turned.center == pytest.approx([x / 2, -z / 2, y / 2]) and turned.mass == plain.mass
    (copy / "told.npz").write_bytes(b"PK damaged")
    assert not open_asset(copy).inertials
