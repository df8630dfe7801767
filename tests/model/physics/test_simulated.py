"""Saved demos in MuJoCo: handles can be pulled, doors swing, nothing jams."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.shapes import hull_of_shape
from model.io.assets.asset_folder import write_asset
from model.io.export.mjcf import MjcfExporter
from model.io.file_names import FileNames
from model.physics.simulation_values import Physics, PhysicsSettings, physics_of
from tests.model.demos import demo_object

FORCE = 3.0
"""N at a door's edge: what a finger does without thinking."""
FINGER, THICK = 0.003, 0.01
"""Radius in metres of the least finger that a handle must take, and of a finger."""


THINNED = 5
"""Every fifth point of a scan is enough: a surface through all of them takes long."""

Saved = tuple[ArticulatedObject, Physics, Path]


@pytest.fixture(scope="module", params=["cabinet", "oven_scan"])
def saved(request, tmp_path_factory) -> Saved:
    """A demo, its physics, and the URDF of its saved asset, as accepting writes and names it."""
    obj = demo_object(request.param)
    thinned = [
        p
        if p.cloud is None
        else replace(p, cloud=p.cloud.take(np.arange(0, len(p.cloud), THINNED)))
        for p in obj.parts
    ]
    obj = replace(obj, parts=tuple(thinned))
    physics = physics_of(obj)
    folder = tmp_path_factory.mktemp("assets") / request.param
    path = write_asset(obj, folder, provenance={}, physics=physics).urdf
    names = FileNames.of(obj)
    return names.object(obj), names.physics(physics), path


def behind_handle(physics: Physics, joint: Joint) -> tuple[np.ndarray, float]:
    """The roomiest place that has something of the link before it on its way out, and the room."""
    hulls = [hull_of_shape(s) for s in physics.collision[joint.child]]
    way = np.asarray(joint.axis)
    ends = np.array([(h.vertices @ way).max() for h in hulls])
    foremost = np.flatnonzero(ends > ends.max() - 0.01)
    grip = np.concatenate([hulls[i].vertices for i in foremost])
    low, high = grip.min(axis=0), grip.max(axis=0)
    rng = np.random.default_rng(0)
    points = low + rng.random((4000, 3)) * (high - low)
    points -= way * rng.random((4000, 1)) * 0.04
    solid = [hull_of_shape(s) for held in physics.collision.values() for s in held]
    room = np.min([clearance(h, points) for h in solid], axis=0)
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
    spec: Any = mujoco.MjSpec.from_file(str(path))
    ball = mujoco.mjtGeom.mjGEOM_SPHERE
    hand = spec.worldbody.add_body(name="hand", mocap=True, pos=at)
    hand.add_geom(type=ball, size=[0.001, 0, 0], contype=0, conaffinity=0)
    finger = spec.worldbody.add_body(name="finger", pos=at, gravcomp=1)
    finger.add_freejoint()
    finger.add_geom(type=ball, size=[radius, 0, 0], mass=0.02)
    kind = {"type": mujoco.mjtEq.mjEQ_WELD, "objtype": mujoco.mjtObj.mjOBJ_BODY}
    stiff = {"solref": [0.01, 1], "data": [0] * 10 + [1, 0]}
    spec.add_equality(name1="hand", name2="finger", **kind, **stiff)
    return spec.compile()


def test_a_finger_behind_the_handle_pulls_a_drawer_open(saved: Saved):
    obj, physics, path = saved
    drawer = next(j for j in obj.tree.joints if j.type == "prismatic")
    at, room = behind_handle(physics, drawer)
    assert room > FINGER
    model = with_finger(path, at, min(0.6 * room, THICK))
    data = mujoco.MjData(model)
    address = model.joint(drawer.name).qposadr[0]
    for step in range(1500):
        data.mocap_pos[0] = at + np.asarray(drawer.axis) * min(step / 1000, 1.0) * 0.2
        mujoco.mj_step(model, data)
    assert data.qpos[address] > 0.1
    others = [j.name for j in obj.tree.joints if j.moves and j.name != drawer.name]
    assert max(abs(data.joint(n).qpos[0]) for n in others) < 0.02


def test_doors_swing_and_drawers_slide_under_a_small_force(saved: Saved):
    obj, physics, path = saved
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
        reach = 0.9 * min(joint.upper, 1.5) if joint.rotates else 0.9 * joint.upper
        for _ in range(4000):
            mujoco.mj_kinematics(model, data)
            turned = data.xmat[body].reshape(3, 3)
            point = data.xpos[body] + turned @ (far - joint.origin)
            axis = np.asarray(joint.axis)
            way = np.cross(axis, point - data.xpos[body]) if joint.rotates else axis
            data.qfrc_applied[:] = 0
            push, out = FORCE * way / np.linalg.norm(way), data.qfrc_applied
            mujoco.mj_applyFT(model, data, push, np.zeros(3), point, body, out)
            mujoco.mj_step(model, data)
            if data.joint(joint.name).qpos[0] > reach:
                break
        assert data.joint(joint.name).qpos[0] > reach, joint.name


def test_nothing_moves_by_itself(saved: Saved):
    """At rest no shapes of links that move against each other push each other away."""
    obj, _, path = saved
    model = mujoco.MjModel.from_xml_path(str(path))
    model.opt.gravity[:] = 0
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    deep = [(c.geom1, c.geom2) for c in data.contact if c.dist < -1e-5]
    assert [model.geom_bodyid[list(pair)] for pair in deep] == []
    mujoco.mj_step(model, data, nstep=500)
    for joint in (j for j in obj.tree.joints if j.moves):
        assert abs(data.joint(joint.name).qpos[0]) < 1e-3


@pytest.mark.parametrize("name", ["laptop", "office_chair"])
def test_what_stands_on_a_floor_stays_in_the_pose_it_was_scanned_in(name: str, tmp_path: Path):
    obj = demo_object(name)
    physics = physics_of(obj, PhysicsSettings(fixed_base=False))
    MjcfExporter().export(obj, tmp_path, physics=physics)
    spec: Any = mujoco.MjSpec.from_file(str(tmp_path / "object.xml"))
    hulls = [hull_of_shape(s) for held in physics.collision.values() for s in held]
    floor = min(h.bounds[0, 2] for h in hulls)
    plane = mujoco.mjtGeom.mjGEOM_PLANE
    spec.worldbody.add_geom(type=plane, size=[5, 5, 0.1], pos=[0, 0, floor])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    base = data.body(obj.tree.root)
    assert np.linalg.norm(base.xpos) < 0.01 and base.xmat[8] > np.cos(np.radians(1.0))
    for joint in (j for j in obj.tree.joints if j.limited and j.moves):
        span = joint.upper - joint.lower
        assert abs(data.joint(joint.name).qpos[0]) < 0.02 * span + 1e-3, joint.name


def test_a_lid_weighs_less_than_what_it_is_on():
    for name, lid in (("laptop", "screen"), ("kettle", "lid")):
        obj = demo_object(name)
        masses = physics_of(obj, PhysicsSettings(collision=None)).inertials
        of = {p.name: masses[p.link].mass for p in obj.parts}
        assert of.pop(lid) < 0.7 * max(of.values()), name
