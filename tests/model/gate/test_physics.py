"""Joints driven in MuJoCo."""

from __future__ import annotations

from dataclasses import replace

import pytest
from cabinets import DOOR, DRAWER, box, cabinet, part

from model.gate import physics
from model.gate.gate import run_gate
from model.gate.physics import run_physics
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint, Mimic
from model.kinematics.tree import KinematicTree

pytest.importorskip("mujoco")


def test_a_good_cabinet_is_driven_there_and_back():
    said = run_physics(cabinet())
    assert said.ran and not said.problem
    assert not said.exploded and not said.drifted and not said.missed
    # Two joints, two ways each where they have two, with gravity and without.
    assert said.seconds > 4 * 2 * physics.DRIVE * 0.99


@pytest.mark.parametrize("size", [0.01, 30.0])
def test_the_size_of_the_object_plays_no_part(size):
    def scaled(joint: Joint) -> Joint:
        origin = tuple(v * size for v in joint.origin)
        upper = joint.upper if joint.rotates else joint.upper * size
        return replace(joint, origin=origin, upper=upper)

    obj = cabinet(scaled(DOOR), scaled(DRAWER))
    parts = tuple(
        replace(p, mesh=replace(p.mesh, vertices=p.mesh.vertices * size)) for p in obj.parts
    )
    said = run_physics(replace(obj, parts=parts))
    assert said.ran
    assert not said.exploded


def pair(multiplier: float) -> ArticulatedObject:
    """Two blocks on a board; the second follows the first, and has 0.1 m to go."""
    tree = KinematicTree(
        ("link_0", "link_1", "link_2"),
        (
            Joint("a", "prismatic", "link_0", "link_1", (1, 0, 0), lower=0, upper=0.1),
            Joint(
                "b", "prismatic", "link_0", "link_2", (1, 0, 0), lower=0, upper=0.1,
                mimic=Mimic("a", multiplier),
            ),
        ),
    )  # fmt: skip
    parts = (
        part("link_0", box([0, 0, -0.05], [1, 0.5, 0])),
        part("link_1", box([0.1, 0.1, 0], [0.2, 0.2, 0.1])),
        part("link_2", box([0.1, 0.3, 0], [0.2, 0.4, 0.1])),
    )
    return ArticulatedObject("pair", parts, tree)


def test_a_follower_that_is_sent_beyond_its_limits_is_told():
    good = run_physics(pair(1.0))
    assert not good.exploded and not good.missed and not good.drifted
    bad = run_physics(pair(20.0))
    assert bad.missed.keys() | bad.exploded.keys()
    report = run_gate(pair(20.0))
    found = [f for j in report.joints for f in j.findings if f.kind == "physics"]
    assert found and found[0].sentence.startswith("In MuJoCo it ")


def test_without_mujoco_the_gate_says_so(monkeypatch):
    monkeypatch.setattr(physics.importlib.util, "find_spec", lambda name: None)
    said = run_physics(cabinet())
    assert not said.ran
    assert "not installed" in said.problem
    assert run_gate(cabinet()).verdict == "fine"


def test_real_collision_shapes_can_take_part():
    pytest.importorskip("model.collision.build")
    said = run_physics(cabinet(), colliders="shapes")
    assert said.ran and said.colliders == "shapes"
    assert not said.exploded
