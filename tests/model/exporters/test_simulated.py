"""Exported demos in MuJoCo: handles can be pulled, doors swing, nothing jams."""

from __future__ import annotations

from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

import mujoco
import numpy as np
import pytest

from model.collision.shapes import hull_of_shape
from model.exporters.physics import Physics, physics_of
from model.exporters.registry import load_exporter
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint
from tests.model.exporters.demos import demo_object

FORCE = 3.0
"""N at a door's edge: what a finger does without thinking."""
FINGER = 0.003
"""Radius in metres of the least finger that a handle must take."""


def written(name: str, folder: Path) -> tuple[ArticulatedObject, Physics, Path]:
    obj = demo_object(name)
    physics = physics_of(obj)
    return obj, physics, load_exporter("mjcf").export(obj, folder, physics=physics)[0]


@pytest.fixture(scope="module")
def cabinet(tmp_path_factory):
    return written("cabinet", tmp_path_factory.mktemp("cabinet"))


def behind_handle(physics: Physics, joint: Joint) -> tuple[np.ndarray, float]:
    """The roomiest place that has something of the link before it on its way out, and the room."""
    hulls = [hull_of_shape(s) for s in physics.collision[joint.child]]
    way = np.asarray(joint.axis)
    ends = np.array([(h.vertices @ way).max() for h in hulls])
    grip = np.concatenate([h.vertices for h, e in zip(hulls, ends, strict=True)
                           if e > ends.max() - 0.01])  # fmt: skip
    low, high = grip.min(axis=0), grip.max(axis=0)
    rng = np.random.default_rng(0)
    points = low + rng.random((4000, 3)) * (high - low)
    points -= way * rng.random((4000, 1)) * 0.04
    room = np.min([clearance(h, points) for h in hulls], axis=0)
    steps = np.linspace(0.0, 0.06, 25)
    before = np.zeros(len(points), bool)
    for step in steps:
        for hull in hulls:
            before |= hull.contains(points + step * way)
    room[~before] = 0.0
    best = int(room.argmax())
    return points[best], float(room[best])


def clearance(hull: Any, points: np.ndarray) -> np.ndarray:
    """(N,) metres that points are outside of the hull's nearest separating plane."""
    return np.maximum((points @ hull.planes[:, :3].T + hull.planes[:, 3]).max(axis=1), 0.0)


def with_finger(path: Path, at: np.ndarray, radius: float) -> mujoco.MjModel:
    """The model and a weightless ball that follows a hand."""
    root = ET.parse(path).getroot()
    world = root.find("worldbody")
    assert world is not None
    place = " ".join(map(str, at))
    hand = ET.SubElement(world, "body", name="hand", mocap="true", pos=place)
    ET.SubElement(hand, "geom", type="sphere", size="0.001", contype="0", conaffinity="0")
    finger = ET.SubElement(world, "body", name="finger", pos=place, gravcomp="1")
    ET.SubElement(finger, "freejoint")
    ET.SubElement(finger, "geom", type="sphere", size=str(radius), mass="0.02")
    equality = root.find("equality")
    if equality is None:
        equality = ET.SubElement(root, "equality")
    ET.SubElement(equality, "weld", body1="hand", body2="finger", solref="0.01 1")
    target = path.with_name("with_finger.xml")
    ET.ElementTree(root).write(target)
    return mujoco.MjModel.from_xml_path(str(target))


def test_a_finger_behind_the_handle_pulls_a_drawer_open(cabinet):
    obj, physics, path = cabinet
    drawer = next(j for j in obj.tree.joints if j.type == "prismatic")
    at, room = behind_handle(physics, drawer)
    assert room > FINGER
    model = with_finger(path, at, 0.6 * room)
    data = mujoco.MjData(model)
    address = model.joint(drawer.name).qposadr[0]
    for step in range(1500):
        data.mocap_pos[0] = at + np.asarray(drawer.axis) * min(step / 1000, 1.0) * 0.2
        mujoco.mj_step(model, data)
    assert data.qpos[address] > 0.1
    others = [j.name for j in obj.tree.joints if j.moves and j.name != drawer.name]
    assert max(abs(data.joint(n).qpos[0]) for n in others) < 0.02


def test_doors_swing_and_drawers_slide_under_a_small_force(cabinet):
    obj, physics, path = cabinet
    model = mujoco.MjModel.from_xml_path(str(path))
    for joint in (j for j in obj.tree.joints if j.moves and j.limited):
        data = mujoco.MjData(model)
        body = model.body(joint.child).id
        corners = np.concatenate(
            [hull_of_shape(s).vertices for s in physics.collision[joint.child]]
        )
        arm = corners - joint.origin
        radial = arm - np.outer(arm @ joint.axis, joint.axis)
        far = corners[np.linalg.norm(radial, axis=1).argmax()]
        reach = 0.5 * min(joint.upper, 0.8) if joint.rotates else 0.5 * joint.upper
        for _ in range(3000):
            mujoco.mj_kinematics(model, data)
            turned = data.xmat[body].reshape(3, 3)
            point = data.xpos[body] + turned @ (far - joint.origin)
            axis = np.asarray(joint.axis)
            way = np.cross(axis, point - data.xpos[body]) if joint.rotates else axis
            data.qfrc_applied[:] = 0
            mujoco.mj_applyFT(model, data, FORCE * way / np.linalg.norm(way), np.zeros(3), point,
                              body, data.qfrc_applied)  # fmt: skip
            mujoco.mj_step(model, data)
            if data.joint(joint.name).qpos[0] > reach:
                break
        assert data.joint(joint.name).qpos[0] > reach, joint.name


def test_nothing_moves_by_itself(cabinet):
    """At rest no shapes of links that move against each other push each other away."""
    obj, _, path = cabinet
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    pushing = [(model.geom_bodyid[c.geom1], model.geom_bodyid[c.geom2])
               for c in data.contact if c.dist < -1e-5]  # fmt: skip
    assert pushing == []
    mujoco.mj_step(model, data, nstep=500)
    for joint in (j for j in obj.tree.joints if j.moves):
        assert abs(data.joint(joint.name).qpos[0]) < 1e-3
