"""Objects that go from format to format: what must come back, and what a format can't hold.

The middle file is read by ArtiWorld, as a person would open it; the last one by other software,
against the object at the start.
"""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject
from model.core.composite_joints import Composite, composite_of, with_composite
from model.core.tree import KinematicTree
from model.data.folders import Bundled
from model.io.assets.reader import load_object, random_q
from model.io.export.registry import load_exporter, write_object
from model.io.readback import read_back
from model.physics.simulation_values import Physics, physics_of, plain_physics
from tests.model.io.test_exporters import make_object
from tests.model.validation.cabinets import cabinet

pytest.importorskip("mujoco")
pytest.importorskip("pxr")

SOURCES = ("urdf", "mjcf", "usd", "sdf")
"""Formats that open with their joints."""
TARGETS = (*SOURCES, "glb")
KINDS = {"plane": "planar", "lift": "lift_and_swivel"} | {k: k for k in ("ball", "universal")}
MOTIONS = {"screw": Composite("screw", 0.02)} | {n: Composite(k) for n, k in KINDS.items()}


@dataclass(frozen=True)
class Held:
    """What a format holds besides motion, masses and shapes; docs/formats.md says the same.

    Attributes:
        category: of the object. names: of the parts. fixed_joints: names of joints that don't move.
        colors: of each vertex.
    """

    category: bool
    names: bool
    fixed_joints: bool
    colors: bool


HELD = {
    "urdf": Held(category=False, names=True, fixed_joints=True, colors=True),
    "mjcf": Held(category=False, names=True, fixed_joints=False, colors=False),
    "usd": Held(category=True, names=True, fixed_joints=True, colors=True),
    "sdf": Held(category=False, names=True, fixed_joints=True, colors=True),
}


@cache
def source(name: str) -> tuple[ArticulatedObject, Physics]:
    if name == "all kinds of joints and parts":
        obj = make_object()
    elif name in MOTIONS:
        obj = cabinet()
        tree = with_composite(obj.tree, "link_1", MOTIONS[name], lambda x: x.startswith("link_"))
        obj = replace(obj, tree=tree)
    elif name == "cabinet with shapes":
        obj = replace(cabinet(), category="Cabinet")
        return obj, physics_of(obj)
    else:
        obj = Bundled().load(name).object
    return obj, plain_physics(obj)


@cache
def through(name: str, format: str, folder: Path) -> tuple[Path, ArticulatedObject]:
    obj, physics = source(name)
    path = write_object(obj, load_exporter(format), folder / name / format, physics=physics)[0]
    return path, load_object(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("trips")


def same_motion(ours: ArticulatedObject, theirs: ArticulatedObject) -> None:
    """Joints, limits and the poses of all links."""
    assert {j.child: j.type for j in theirs.tree.joints} == {
        j.child: j.type for j in ours.tree.joints
    }
    rng = np.random.default_rng(0)
    for q in ({}, random_q(ours, rng), random_q(ours, rng)):
        there = theirs.pose(q)
        for link, pose in ours.pose(q).items():
            np.testing.assert_allclose(there[link], pose, atol=1e-5)
    for joint in (j for j in ours.tree.joints if j.moves):
        back = theirs.tree.by_name[joint.name]
        assert (back.lower, back.upper) == pytest.approx((joint.lower, joint.upper), abs=1e-5)
        assert (back.mimic is None) == (joint.mimic is None)


def same_bodies(ours: ArticulatedObject, physics: Physics, theirs: ArticulatedObject) -> None:
    """Masses, tensors and sizes."""
    for part in ours.parts:
        inertial = physics.inertials[part.link]
        back = theirs.inertials[part.link]
        assert back.mass == pytest.approx(inertial.mass, rel=1e-4)
        scale = float(np.abs(inertial.tensor).max())
        np.testing.assert_allclose(back.tensor, inertial.tensor, atol=max(1e-3 * scale, 1e-9))
        bounds = next(p for p in theirs.parts if p.link == part.link).bounds
        np.testing.assert_allclose(bounds, part.bounds, atol=0.02 if part.mesh is None else 1e-5)


SMALL = ("all kinds of joints and parts", "cabinet with shapes", *MOTIONS)
BUNDLED = ("laptop", "kettle", "cabinet", "desk_lamp")


@pytest.mark.parametrize("format", SOURCES)
@pytest.mark.parametrize("name", (*SMALL, *BUNDLED))
def test_what_is_written_is_read(name, format, folder):
    obj, physics = source(name)
    back = through(name, format, folder)[1]
    same_motion(obj, back)
    same_bodies(obj, physics, back)
    if name in MOTIONS:
        motion = composite_of(back.tree, "link_1", lambda x: x.startswith("link_"))
        assert motion.kind == MOTIONS[name].kind
        assert motion.pitch == pytest.approx(MOTIONS[name].pitch, rel=1e-5)


@pytest.mark.parametrize("target", TARGETS)
@pytest.mark.parametrize("format", SOURCES)
@pytest.mark.parametrize("name", ("all kinds of joints and parts", "screw"))
def test_every_pair_of_formats(name, format, target, folder, tmp_path):
    obj = source(name)[0]
    _, middle = through(name, format, folder)
    last = write_object(middle, load_exporter(target), tmp_path, physics=plain_physics(middle))[0]
    joints = tuple(
        j if j.moves else replace(j, name=middle.tree.joint_of[j.child].name)
        for j in obj.tree.joints
    )
    judged = read_back(target, last, replace(obj, tree=KinematicTree(obj.tree.links, joints)))
    assert judged.readers and not judged.problems
    if target in SOURCES:
        same_motion(obj, load_object(last))


@pytest.mark.parametrize("format", SOURCES)
def test_what_each_format_holds_besides(format, folder):
    obj, physics = source("cabinet with shapes")
    _, back = through("cabinet with shapes", format, folder)
    held = HELD[format]
    assert {link: len(s) for link, s in back.shapes.items()} == {
        link: len(s) for link, s in physics.collision.items()
    }
    for name, dynamics in physics.dynamics.items():
        said = back.tree.by_name[name].dynamics
        assert said is not None and said.damping == pytest.approx(dynamics.damping, rel=1e-4)
        assert said.friction == pytest.approx(dynamics.friction, rel=1e-4)
    assert (back.category is not None) == held.category
    assert ({p.link: p.name for p in back.parts} == {p.link: p.name for p in obj.parts}) == (
        held.names
    )
    mixed = source("all kinds of joints and parts")[0]
    _, back = through("all kinds of joints and parts", format, folder)
    assert ("fix" in back.tree.by_name) == held.fixed_joints
    painted = {p.link: p.mesh for p in back.parts}["link_4"]
    assert mixed.parts[4].mesh.vertex_colors is not None
    assert (painted.vertex_colors is not None) == held.colors
