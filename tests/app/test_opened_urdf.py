"""A URDF in the app: its joints are the first tree, predicted anew on request, and saved."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from app.cli.commands import ServeCommand
from app.cli.serve import scene_to_open
from app.server.accepting import accept
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.open_object import OpenObject
from app.server.part_tasks import articulated_object
from app.server.tasks import arrays_of, stamp
from app.viewer.panels.joint_tree import joint_note
from app.viewer.steps.review import summary
from model.core.joint import JointDynamics
from model.io.assets.reader import declared_entry, load_object
from model.io.open_asset import open_asset
from model.physics.simulation_values import PhysicsSettings, physics_of
from sessions import commands as cmd
from sessions.store import Store
from tests.app.run_cli import answer
from tests.builders import wait_until
from tests.model.io.test_named_meshes import glb

URDF = """<robot name="r"><link name="body"><visual><geometry>
<mesh filename="meshes/body.ply"/></geometry></visual></link>
<link name="door"><visual><geometry><mesh filename="meshes/door.ply"/></geometry></visual></link>
<joint name="hinge" type="revolute"><origin xyz="-0.3 -0.151 0"/><axis xyz="0 0 -1"/>
<parent link="body"/><child link="door"/><limit lower="0" upper="1.2"/></joint></robot>"""


@pytest.fixture
def urdf(tmp_path: Path) -> Path:
    folder = tmp_path / "cupboard"
    (folder / "meshes").mkdir(parents=True)
    body = trimesh.creation.box(bounds=[[-0.3, -0.13, 0], [0.3, 0.15, 0.4]])
    body.export(folder / "meshes" / "body.ply")
    # Seen from the joint.
    door = trimesh.creation.box(bounds=[[0, 0, 0], [0.6, 0.02, 0.4]])
    door.export(folder / "meshes" / "door.ply")
    (folder / "cupboard.urdf").write_text(URDF)
    return folder / "cupboard.urdf"


@pytest.fixture
def opened(tmp_path: Path) -> Iterator[Callable[[Path], OpenObject]]:
    states: list[AppState] = []

    def begin(path: Path, *, parts: bool = True) -> OpenObject:
        workspace = tmp_path / "workspace"
        app_state = AppState(ServeConfig(workspace=workspace), Store(workspace), [path])
        states.append(app_state)
        obj = app_state.object(app_state.queue.records()[0].id)
        wait_until(lambda: obj.labels is not None if parts else obj.asset, "it is open")
        wait_until(lambda: not obj.jobs, "nothing is under way")
        return obj

    yield begin
    for app_state in states:
        app_state.close()


def kinds(obj: OpenObject) -> list[str]:
    return [e.kind for e in obj.services.store.history(obj.record.id)]


def test_its_joints_are_there_at_once_and_the_segmenter_is_not_asked(opened, urdf: Path) -> None:
    obj = opened(urdf)
    doc = obj.document
    assert [(p.id, p.name) for p in doc.parts] == [(0, "body"), (1, "door")]
    assert doc.tree is not None and doc.tree.joint_of["link_1"].upper == 1.2
    assert doc.prediction is not None and doc.prediction.file == "cupboard.urdf"
    assert doc.segmentation is not None and doc.segmentation.counts == {0: 12, 1: 12}
    assert not doc.prediction_stale and not doc.predicted_confidence and not doc.edited_joints
    assert kinds(obj) == ["name_part", "apply_tool", "record_segmentation", "record_prediction"]
    assert summary(doc).startswith("**From cupboard.urdf**"), "nobody predicted that"
    said = joint_note(doc.tree.joint_of["link_1"], doc, [])
    assert said == "*From cupboard.urdf.*"


def test_a_saved_asset_is_called_after_its_folder(opened, urdf: Path) -> None:
    """Each was "object" in the queue, as the file of every saved asset is called so."""
    obj = opened(urdf.rename(urdf.with_name("object.urdf")))
    assert obj.record.name == "cupboard"
    assert open_asset(obj.record.path).name == "cupboard"


def test_it_can_be_taken_back_and_is_not_taken_again(opened, urdf: Path) -> None:
    obj = opened(urdf)
    obj.do(cmd.Undo(), "tester")
    assert obj.document.tree is None and obj.document.prompts
    obj.do(cmd.Undo(), "tester")
    assert not obj.document.prompts
    obj.services.workers.close()
    again = opened(urdf, parts=False)
    assert again.document.tree is None and not again.document.prompts


def test_p_predicts_anew_and_undo_brings_the_file_back(opened, urdf: Path) -> None:
    obj = opened(urdf)
    obj.predict("tester")
    wait_until(lambda: obj.document.prediction.file is None, "another prediction")
    assert obj.document.tree is not None and obj.document.prediction.backend
    obj.do(cmd.Undo(), "tester")
    assert obj.document.prediction is not None and obj.document.prediction.file == "cupboard.urdf"


def test_read_in_another_frame_it_begins_with_its_joints_again(opened, urdf: Path) -> None:
    obj = opened(urdf)
    obj.do(cmd.SetFrame("z", 0.5), "tester")
    wait_until(lambda: obj.document.tree is not None, "the tree in the other unit")
    tree: Any = obj.document.tree
    assert tree.joint_of["link_1"].origin[0] == pytest.approx(-0.15)


def test_the_saved_asset_says_that_the_joints_came_from_the_file(opened, urdf: Path) -> None:
    obj = opened(urdf)
    wait_until(lambda: obj.validation.report is not None and not obj.jobs, "the gate")
    accept(obj, "", "tester", seen=obj.validation.report)
    wait_until(lambda: obj.document.saved, "it is saved")
    folder = Path(obj.document.saved.folder)
    told = json.loads((folder / "provenance.json").read_text())
    assert (told["predictor"]["file"], told["predictor"]["by"]) == ("cupboard.urdf", "source file")
    assert told["source"]["path"].endswith("cupboard.urdf") and told["edits"] == []
    again = open_asset(folder)
    assert again.tree is not None and again.tree.joint_of["link_1"].name == "hinge"
    assert again.part_names == ("body", "door")


MASS = """<inertial><origin xyz="0.3 0 0"/><mass value="2.5"/><inertia ixx="0.03" ixy="0" ixz="0"
iyy="0.04" iyz="0" izz="0.05"/></inertial>"""


COLLISION = """<collision><origin xyz="0.3 0.01 0.2"/><geometry><box size="0.5 0.02 0.3"/>
</geometry></collision><collision><geometry><sphere radius="0.01"/></geometry></collision>"""
DOOR_SHAPES = [("box", (0.5, 0.02, 0.3), [0, -0.141, 0.2]), ("sphere", (0.01,), [-0.3, -0.151, 0])]


def shown(shapes: Sequence[Any]) -> list[Any]:
    return [(s.kind, s.sizes, s.object_from_shape[:3, 3].round(9).tolist()) for s in shapes]


def test_masses_dynamics_and_collision_shapes_of_the_file_are_kept(opened, urdf: Path) -> None:
    text = URDF.replace('name="body">', 'name="body">' + MASS.replace("2.5", "7"))
    text = text.replace('name="door">', 'name="door">' + MASS + COLLISION)
    told = '<limit effort="12" velocity="1.5"'
    text = text.replace("<limit", '<dynamics damping="0.7" friction="0.3"/>' + told)
    urdf.write_text(text)
    obj = opened(urdf)
    tree: Any = obj.document.tree
    made = articulated_object(obj.source(obj.document), tree)
    told_of = made.inertials
    assert shown(made.shapes["link_1"]) == DOOR_SHAPES
    assert {k: i.mass for k, i in told_of.items()} == {"link_0": 7.0, "link_1": 2.5}
    wait_until(lambda: obj.validation.report is not None and not obj.jobs, "the gate")
    accept(obj, "", "tester", seen=obj.validation.report)
    wait_until(lambda: obj.document.saved, "it is saved")
    folder = Path(obj.document.saved.folder)
    asset = json.loads((folder / "provenance.json").read_text())["asset"]
    every = ["damping", "friction", "effort", "velocity"]
    assert asset["told"] == {
        "masses": ["body_0", "door_1"], "dynamics": {"hinge": every}, "collision": ["door_1"],
    }  # fmt: skip
    again = load_object(folder)
    assert {k: shown(held) for k, held in again.shapes.items()} == {"door_1": DOOR_SHAPES}
    assert {k: shown(held) for k, held in open_asset(folder).shapes.items()} == {
        "link_1": DOOR_SHAPES
    }
    door = again.inertials["door_1"]
    assert door.mass == 2.5 and door.center == pytest.approx([0.0, -0.151, 0.0])
    assert np.diag(door.tensor) == pytest.approx([0.03, 0.04, 0.05])
    assert physics_of(again, PhysicsSettings(collision=None)).dynamics["hinge"] == JointDynamics(
        0.7, 0.3, 12.0, 1.5
    )


def test_a_part_that_was_cut_again_has_a_mass_and_shapes_of_ours(opened, urdf: Path) -> None:
    urdf.write_text(URDF.replace('name="door">', 'name="door">' + MASS + COLLISION))
    obj = opened(urdf)
    arrays = arrays_of(obj.services.workspace)
    labels = arrays.get(obj.document.segmentation.labels).copy()
    labels[-2:] = 0
    source = replace(obj.source(obj.document), labels=arrays.put(labels))
    made = articulated_object(source, obj.document.tree)
    assert not made.inertials and not made.shapes
    assert declared_entry(made) == {"masses": [], "dynamics": {}, "collision": []}


def test_a_mesh_that_changed_is_read_again(urdf: Path) -> None:
    before = stamp(urdf)
    os.utime(urdf.parent / "meshes" / "door.ply", ns=(0, 0))
    assert stamp(urdf) != before


def test_a_urdf_is_no_scene(urdf: Path) -> None:
    assert scene_to_open(ServeCommand(paths=(urdf,))) is None


def test_a_glb_whose_meshes_are_called_after_parts_opens_with_them(opened, tmp_path: Path) -> None:
    path = glb(tmp_path / "cab.glb", "door", "body")
    obj = opened(path)
    assert obj.document.part_names == {0: "body", 1: "door"} and obj.document.tree is None
    obj.do(cmd.Undo(), "tester")
    assert not obj.document.prompts


def predict(path: Path, out: Path) -> dict[str, Any]:
    return answer("predict", path, "--out", out)


def test_predict_keeps_the_masses_that_a_file_tells(urdf: Path, tmp_path: Path) -> None:
    urdf.write_text(URDF.replace('name="door">', 'name="door">' + MASS))
    predict(urdf, tmp_path / "out")
    made = load_object(tmp_path / "out")
    assert {k: i.mass for k, i in made.inertials.items()} == {"door_1": 2.5}
    told = json.loads((tmp_path / "out" / "provenance.json").read_text())["asset"]["told"]
    assert told == {"masses": ["door_1"], "dynamics": {}, "collision": []}, "joints are predicted"


def test_predict_keeps_the_shapes_of_a_file_that_tells_all(urdf: Path, tmp_path: Path) -> None:
    body = '<collision><geometry><box size="0.6 0.28 0.4"/></geometry></collision>'
    text = URDF.replace('name="door">', 'name="door">' + COLLISION)
    urdf.write_text(text.replace('name="body">', 'name="body">' + body))
    report = predict(urdf, tmp_path / "out")
    assert report["collision_from_source"] == ["body_0", "door_1"]
    assert report["collision_shapes"] == 3
    made = load_object(tmp_path / "out")
    assert shown(made.shapes["door_1"]) == DOOR_SHAPES


@pytest.mark.parametrize("source", ["urdf", "glb"])
def test_predict_takes_what_tells_its_parts(source: str, urdf: Path, tmp_path: Path) -> None:
    path = urdf if source == "urdf" else glb(tmp_path / "cab.glb", "body", "door")
    told = predict(path, tmp_path / "out")
    assert [p["name"] for p in told["parts"]] == ["body", "door"] and told["joints"]
