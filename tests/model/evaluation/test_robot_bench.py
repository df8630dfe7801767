"""A gripper that opens exports in MuJoCo, by contact alone."""

from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from PIL import Image

from model.core.errors import InputFileError
from model.data.registry import DatasetOptions
from model.evaluation.gripper import DEEP, GripperBench, Try
from model.evaluation.robot import (
    Film,
    JointScore,
    RobotConfig,
    RobotScore,
    kind_of,
    open_all,
    open_scene,
    reasons,
    row,
    run,
)
from model.io.export.mjcf import MjcfExporter
from model.physics.affordances import REACHED
from model.physics.simulation_values import physics_of
from tests.model.validation.cabinets import DOOR, DRAWER, cabinet
from tests.model.validation.handles import with_handles


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """The cabinet with handles, its physics and its MJCF."""
    obj = with_handles(cabinet())
    physics = physics_of(obj)
    folder = tmp_path_factory.mktemp("cabinet")
    return obj, physics, MjcfExporter().export(obj, folder, physics=physics)[0]


def first(bench: GripperBench, joint: str):
    return next(a for a in bench.affordances if a.joint == joint)


@pytest.mark.parametrize("joint", ["door", "drawer"])
def test_the_gripper_opens_door_and_drawer(made, joint):
    bench = GripperBench(made[2])
    found = bench.open(first(bench, joint))
    assert found.why == "" and found.moved >= REACHED and found.deepest < DEEP
    assert bench.opened(joint) >= REACHED
    other = {"door": "drawer", "drawer": "door"}[joint]
    assert abs(bench.opened(other)) < 0.1


def test_without_a_hand_nothing_moves(made):
    """What opens the joints is contact: left alone, the object stays as it is."""
    bench = GripperBench(made[2])
    away = replace(first(bench, "drawer"), center=(0.0, -3.0, 0.0))
    found = bench.open(away)
    assert found.why == "slipped" and abs(found.moved) < 0.01


def test_a_welded_drawer_is_not_opened(made):
    path = made[2]
    tree = ET.parse(path)
    held = ET.SubElement(tree.getroot(), "equality")
    ET.SubElement(held, "weld", body1="link_0", body2="link_2", solref="0.004 1")
    welded = path.with_name("welded.xml")
    tree.write(welded)
    bench = GripperBench(welded)
    found = bench.open(first(bench, "drawer"))
    assert found.why in ("stuck", "slipped") and found.moved < 0.2
    assert bench.jams("drawer") and not bench.jams("door")
    (score,) = open_all(bench, ["drawer"])
    assert not score.opened and score.why == "jams under a motor, too"


def test_an_affordance_on_the_wrong_side_fails(made):
    bench = GripperBench(made[2])
    right = first(bench, "door")
    # A push from the front, beside the hinge: it shuts the door.
    at = (0.05, right.center[1] + 0.05, 0.0)
    wrong = replace(right, kind="push", center=at, width=0.0)
    wrong = replace(wrong, normal=(0, -1, 0), closing=(0, 0, 1))
    found = bench.open(wrong)
    assert found.why and found.moved < 0.1


def test_affordances_of_the_object_are_those_that_are_tried(made, tmp_path: Path):
    obj, physics, path = made
    own = first(GripperBench(path), "drawer")
    shifted = replace(own, center=(own.center[0] + 0.9, *own.center[1:]))
    obj = replace(obj, affordances=(shifted,))
    bench = GripperBench(MjcfExporter().export(obj, tmp_path, physics=physics)[0])
    (only,) = (a for a in bench.affordances if a.joint == "drawer")
    assert np.allclose(only.center, shifted.center, atol=1e-5)
    assert bench.open(only).why == "slipped"  # it closes on air


def test_a_scene_is_opened_by_its_file_alone(made):
    score = open_scene(made[2], most=1)
    assert [j.joint for j in score.joints] == ["door"] and score.joints[0].opened


def test_a_film_shows_the_motion(made, tmp_path: Path):
    obj, _, path = made
    bench = GripperBench(path)
    film = Film(obj, bench)
    bench.open(first(bench, "drawer"), film.watch)
    film.keep(True)
    film.save(tmp_path / "films" / "cabinet.gif")
    image = Image.open(tmp_path / "films" / "cabinet.gif")
    frames = []
    for k in range(image.n_frames):
        image.seek(k)
        frames.append(np.asarray(image.convert("RGB"), np.int16))
    assert len(frames) > 5
    assert np.abs(frames[0] - frames[-1]).max() > 50


def test_a_file_that_is_no_mjcf_is_named(tmp_path: Path):
    path = tmp_path / "scene.xml"
    path.write_text("no XML")
    with pytest.raises(InputFileError, match=r"scene\.xml: MuJoCo can't load it"):
        GripperBench(path)
    path.write_text("<mujoco/>")
    with pytest.raises(InputFileError, match=r"scene\.xml: says of no joint"):
        open_scene(path, most=1)


def test_bundled_objects_are_measured():
    config = RobotConfig(DatasetOptions("bundled"), half="all", limit=1, jobs=1)
    (score,) = run(config)
    assert not score.problem and score.joints
    found = row("x", [score])
    assert found["opened"] == np.mean([j.opened for j in score.joints])


def test_what_fails_is_counted():
    joints = (DOOR, DRAWER, replace(DRAWER, upper=0.004))
    assert [kind_of(j) for j in joints] == ["hinge", "slide", "button"]
    lost = RobotScore("a", (JointScore("door", "hinge"),), problem="ValueError: no")
    jammed = replace(lost, joints=(replace(lost.joints[0], jams=True),))
    opened = JointScore("door", "hinge", (Try("grasp", REACHED, 0.0, 1.0),))
    both = row("x", [jammed, RobotScore("b", (opened,))])
    assert both["opened"] == 0.5 and both["of those that a motor moves"] == 1.0
    assert row("x", [lost])["opened"] == 0.0 and reasons([lost]) == {"no affordance": 1}
