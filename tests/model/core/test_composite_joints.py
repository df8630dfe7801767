"""Motions of several joints: screw, ball, universal joint, plane, lift and swivel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from model.core.composite_joints import COMPOSITE_KINDS, COMPOSITES, Composite, composite_of
from model.core.composite_joints import with_composite as made
from model.core.errors import KinematicsError
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree

AXIS = np.array([2.0, -1.0, 2.0]) / 3
AT = np.array([0.3, -0.1, 0.5])
HINGE = Joint("own", "revolute", "link_0", "link_1", tuple(AXIS), tuple(AT), -0.2, 1.5)
TREE = KinematicTree(
    ("link_0", "link_1", "link_2"),
    (
        HINGE,
        Joint("rider", "prismatic", "link_1", "link_2", (1, 0, 0), (0, 0, 0), 0, 0.1,
              Mimic("own", 0.05)),
    ),
)  # fmt: skip


def holds(link: str) -> bool:
    return link.startswith("link_")


def turned(kind: str, pitch: float = 0.0, joint: Joint = HINGE) -> KinematicTree:
    return made(TREE.with_joint(joint), "link_1", Composite(kind, pitch), holds)


def motions(kind: str) -> Composite:
    return Composite(kind, -0.004 if kind == "screw" else 0.0)


@pytest.mark.parametrize("pitch", [0.003, -0.02])
def test_a_screw_advances_by_its_pitch_a_turn(pitch):
    tree = turned("screw", pitch)
    for q in (0.0, 1.2, 2 * math.pi):
        pose = tree.pose({"own": q})["link_1"]
        plain = TREE.pose({"own": q})["link_1"]
        np.testing.assert_allclose(pose[:3, :3], plain[:3, :3], atol=1e-12)
        along = pose[:3, 3] - plain[:3, 3]
        np.testing.assert_allclose(along, AXIS * pitch * q / (2 * math.pi), atol=1e-12)
    assert tree.by_name["rider"].mimic == Mimic("own", 0.05)  # it follows the turn on
    slide = tree.joint_of["helper_1"]
    assert (slide.lower, slide.upper) == pytest.approx(
        sorted(pitch * q / (2 * math.pi) for q in (-0.2, 1.5))
    )


def test_what_slid_turns_as_often_as_its_travel_needs():
    slide = replace(HINGE, type="prismatic", lower=0.0, upper=0.012)
    own = turned("screw", 0.004, slide).by_name["own"]
    assert (own.type, own.lower, own.upper) == ("revolute", 0.0, pytest.approx(6 * math.pi))


def test_what_slid_keeps_its_travel_as_a_lift():
    slide = replace(HINGE, type="prismatic", lower=0.0, upper=0.627)
    lift = next(j for j in turned("lift_and_swivel", 0.0, slide).joints if j.slides)
    assert (lift.lower, lift.upper) == (0.0, 0.627)


@pytest.mark.parametrize("kind", COMPOSITE_KINDS)
def test_each_kind_is_recognised_and_can_be_taken_back(kind):
    tree = turned(kind, motions(kind).pitch)
    assert composite_of(tree, "link_1", holds) == motions(kind)
    assert len(tree.links) == 3 + COMPOSITES[kind].helpers
    assert made(tree, "link_1", motions(kind), holds) is tree
    back = made(tree, "link_1", Composite("single"), holds)
    assert set(back.links) == set(TREE.links)
    own = back.by_name["own"]
    np.testing.assert_allclose(own.axis, AXIS, atol=1e-12)
    np.testing.assert_allclose(own.origin, AT, atol=1e-12)
    assert own.mimic is None and own.parent == "link_0"


@pytest.mark.parametrize("first", COMPOSITE_KINDS)
@pytest.mark.parametrize("then", COMPOSITE_KINDS)
def test_any_kind_follows_any_other(first, then):
    once = turned(first, motions(first).pitch)
    twice = made(once, "link_1", motions(then), holds)
    assert composite_of(twice, "link_1", holds) == motions(then)
    np.testing.assert_allclose(twice.pose({})["link_1"], np.eye(4), atol=1e-12)


def test_a_ball_keeps_its_centre_and_a_plane_its_height():
    rng = np.random.default_rng(0)
    ball, plane = turned("ball"), turned("planar")
    for _ in range(5):
        q = {j.name: rng.uniform(-1, 1) for j in ball.joints if j.name != "rider"}
        pose = ball.pose(q)["link_1"]
        np.testing.assert_allclose(pose[:3, :3] @ AT + pose[:3, 3], AT, atol=1e-12)
        q = {j.name: rng.uniform(-1, 1) for j in plane.joints if j.name != "rider"}
        pose = plane.pose(q)["link_1"]
        assert (pose[:3, :3] @ AT + pose[:3, 3] - AT) @ AXIS == pytest.approx(0, abs=1e-12)
        np.testing.assert_allclose(pose[:3, :3] @ AXIS, AXIS, atol=1e-12)


def test_a_lift_keeps_its_stroke_and_frees_what_followed_it():
    tree = turned("lift_and_swivel")
    lift = replace(tree.joint_of["helper_1"], upper=0.25)
    rider = replace(tree.by_name["rider"], mimic=Mimic(lift.name, 1.0))
    tree = tree.with_joint(lift).with_joint(rider)
    assert made(tree, "link_1", Composite("single"), holds).by_name["rider"].mimic is None
    named = made(tree, "link_1", Composite("screw", 0.1), holds)
    assert composite_of(named, "link_1", holds).kind == "screw"


@pytest.mark.parametrize(
    ("kind", "pitch"), [("screw", 0.0), ("ball", 0.1), ("screw", math.nan), ("spiral", 0.0)]
)
def test_what_cannot_be_is_refused(kind, pitch):
    with pytest.raises(KinematicsError):
        Composite(kind, pitch)


def test_the_root_has_no_motion():
    with pytest.raises(KinematicsError, match="it is the root"):
        made(TREE, "link_0", Composite("ball"), holds)
