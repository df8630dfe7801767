"""Joints driven in MuJoCo."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.shapes import hull_of
from model.physics.simulation_values import Physics, physics_of
from model.validation import physics
from model.validation.physics import run_physics
from model.validation.report import Severity
from model.validation.runner import validate
from tests.builders import box, slide
from tests.model.validation.cabinets import DOOR, DRAWER, cabinet, followers, pushed

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


def test_a_follower_that_is_sent_beyond_its_limits_is_told():
    good = run_physics(followers(1.0))
    assert not good.exploded and not good.missed and not good.drifted
    bad = run_physics(followers(20.0))
    assert bad.missed.keys() | bad.exploded.keys()
    report = validate(followers(20.0))
    found = [f for j in report.joints for f in j.findings if f.kind == "physics"]
    assert found and found[0].message.startswith("MuJoCo: ")


def test_what_is_pushed_out_of_its_limits_is_told_with_how_far_and_by_what():
    obj = pushed(slide("pushed", "link_2", 0.02))
    said = run_physics(obj, physics_of(obj))
    assert set(said.exploded) == {"pushed"}
    assert re.fullmatch(
        r"leaves its limits by [\d.]+ mm while drawer 1 is driven, "
        "pushed by the collision shapes of drawer 1",
        said.exploded["pushed"],
    )
    assert said.stops["pushed"].where is not None


def test_without_mujoco_the_gate_says_so(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    said = run_physics(cabinet())
    assert not said.ran
    assert "not installed" in said.problem
    assert validate(cabinet()).severity == Severity.OK


def test_the_shapes_that_are_exported_take_part_and_leave_a_good_cabinet_free():
    obj = cabinet()
    said = run_physics(obj, physics_of(obj))
    assert said.ran and said.shapes > 10
    assert not said.exploded and not said.missed and not said.drifted


def blocked() -> tuple[ArticulatedObject, Physics]:
    """The cabinet with one more collision shape, which nobody sees, in the drawer's way."""
    obj = cabinet()
    made = physics_of(obj)
    post = hull_of(np.asarray(box([0.1, -0.14, 0.0], [0.3, -0.1, 0.6]).vertices))
    shapes = {**made.collision, "link_0": (*made.collision["link_0"], post)}
    return obj, replace(made, collision=shapes)


def test_what_only_the_shapes_run_into_is_told_with_the_place():
    obj, made = blocked()
    said = run_physics(obj, made)
    assert set(said.missed) == {"drawer"}
    assert said.missed["drawer"] > 0.5
    stop = said.stops["drawer"]
    assert stop.other == "link_0"
    assert 0.05 < stop.q["drawer"] < 0.09
    assert -0.15 < stop.where[1] < -0.09
    assert not said.exploded


def test_the_gate_refuses_what_its_shapes_block_and_shrinking_them_is_the_mend(monkeypatch):
    obj, made = blocked()
    monkeypatch.setattr("model.validation.runner.physics_of", lambda *_, **__: made)
    found = validate(obj).of("drawer")
    assert (found.severity, found.worst.kind) == (Severity.ERROR, "physics")
    assert "blocked by the collision shapes of carcass 0" in found.message
    assert [m.kind for m in found.fixes] == ["shrink"]
    assert found.fixes[0].joint == replace(DRAWER, give_way=True)
    assert validate(obj, shapes=False).severity == Severity.OK


def test_shrunk_shapes_free_a_drawer_that_its_cabinet_blocks_and_the_gate_only_looks():
    stop = box([0.1, -0.14, 0.0], [0.3, -0.1, 0.25])
    foot = box([0.1, -0.14, -0.02], [0.3, 0.1, 0.0])
    obj = cabinet(DOOR, DRAWER, stop, foot)
    report = validate(obj)
    found = report.of("drawer")
    assert (found.severity, found.worst.other) == (Severity.ERROR, "link_0")
    mend = found.fixes[-1]
    assert mend.kind == "shrink"
    after = validate(replace(obj, tree=obj.tree.with_joint(mend.joint)))
    assert after.severity == Severity.WARNING
    assert "its collision shapes are shrunk for it" in after.of("drawer").message
    assert after.physics.shapes > 10
    assert not after.physics.missed and not after.physics.exploded
    assert "shrink" not in [m.kind for m in after.of("drawer").fixes]
