"""Snapping a joint to what its part shows."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import trimesh

from app.server import part_tasks
from model.core.articulated_object import Part
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.core.tree import KinematicTree
from tests.builders import box, part


@pytest.mark.parametrize("guess", [(0.01, -0.005), (0.1, -0.01)])
def test_contact_lands_in_the_middle_of_the_barrels(
    guess: tuple[float, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also of a guess that is a hand's width beside the door's edge."""
    knuckles = [
        trimesh.creation.cylinder(0.006, 0.06, sections=12).apply_translation((0.003, -0.026, z))
        for z in (0.1, 0.7)
    ]
    panel = trimesh.creation.box((0.5, 0.02, 0.8)).apply_translation((0.25, -0.011, 0.4))
    wall = trimesh.creation.box((0.02, 0.4, 0.8)).apply_translation((0.01, 0.2, 0.4))
    parts = (part("link_0", wall), part("link_1", panel, *knuckles))
    monkeypatch.setattr(part_tasks, "parts_of", lambda _: parts)
    joint = Joint("j", "revolute", "link_0", "link_1", (0, 0, 1), (*guess, 0.4), 0.0, 1.5)
    tree = KinematicTree(("link_0", "link_1"), (joint,))
    snapped = part_tasks.snap_joint(cast(Any, None), tree, "link_1", "Contact")
    assert snapped.origin[:2] == pytest.approx((0.003, -0.026), abs=1e-6)
    assert snapped.axis == joint.axis


def test_each_joint_of_a_part_snaps_to_that_part(monkeypatch: pytest.MonkeyPatch) -> None:
    """A seat that rises and turns: the helper link between holds nothing to snap to."""
    foot = trimesh.creation.box((0.1, 0.1, 0.4)).apply_translation((0, 0, 0.2))
    seat = trimesh.creation.box((0.5, 0.4, 0.1)).apply_translation((0.02, 0, 0.45))
    parts = (part("link_0", foot), part("link_1", seat))
    monkeypatch.setattr(part_tasks, "parts_of", lambda _: parts)
    rises = Joint("rises", "prismatic", "link_0", "helper_1", (1, 0, 0), (0, 0, 0), 0.0, 0.1)
    turns = Joint("turns", "continuous", "helper_1", "link_1", (1, 0, 0))
    tree = KinematicTree(("link_0", "helper_1", "link_1"), (rises, turns))

    def snapped(child: str, to: str) -> Joint:
        return part_tasks.snap_joint(cast(Any, SimpleNamespace(title="chair")), tree, child, to)

    for joint in (rises, turns):
        assert snapped(joint.child, "axis Short").axis == pytest.approx((0, 0, 1), abs=1e-6)
        assert snapped(joint.child, "Centre").origin == pytest.approx((0.02, 0, 0.45), abs=1e-6)
        assert snapped(joint.child, "Contact").origin[2] == pytest.approx(0.4, abs=0.02)
    upper = snapped("helper_1", "free range").upper
    assert upper is not None and upper > 0.3


def test_equal_parts_are_found_and_get_the_joint_mirrored_where_they_are(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two doors beside each other with knobs in the middle, and a drawer below them."""
    doors = [
        (box([0.01, -0.02, 0], [0.5, 0, 0.8]), box([0.04, -0.06, 0.3], [0.08, -0.02, 0.34])),
        (box([-0.5, -0.02, 0], [-0.01, 0, 0.8]), box([-0.08, -0.06, 0.3], [-0.04, -0.02, 0.34])),
    ]
    parts = (
        part("link_0", box([-0.5, 0, -0.3], [0.5, 0.5, 0.8])),
        *(part(f"link_{k}", *pieces) for k, pieces in enumerate(doors, start=1)),
        part("link_3", box([-0.5, -0.02, -0.3], [0.5, 0, -0.01])),
    )
    monkeypatch.setattr(part_tasks, "parts_of", lambda _: parts)
    assert part_tasks.equal_parts(cast(Any, None), 1, (2, 3)) == (2,)
    right = Joint("a", "revolute", "link_0", "link_1", (0, 0, 1), (0.5, 0, 0.4), 0.0, 1.5)
    still = [Joint(n, "fixed", "link_0", f"link_{k}") for k, n in ((2, "b"), (3, "c"))]
    tree = KinematicTree(("link_0", "link_1", "link_2", "link_3"), (right, *still))
    (left,) = part_tasks.joints_like(cast(Any, None), tree, "link_1", frozenset())
    assert (left.name, left.child, left.type, left.upper) == ("b", "link_2", "revolute", 1.5)
    assert left.axis == pytest.approx((0, 0, -1)) and left.origin[0] == pytest.approx(-0.5)
    assert not part_tasks.joints_like(cast(Any, None), tree, "link_1", frozenset({"link_2"}))
    assert not part_tasks.joints_like(cast(Any, None), tree, "link_3", frozenset())


def test_equal_knobs_of_a_scan_get_the_joint_in_spite_of_its_noise(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Four knobs of one size with some points beside each, and a larger one of the same name."""
    rng = np.random.default_rng(5)

    def knob(link: str, x: float, radius: float) -> Part:
        turns = rng.uniform(0, 2 * np.pi, 240)
        rim = radius * np.sqrt(rng.uniform(0, 1, 240))
        points = np.column_stack([x + rim * np.cos(turns), rim * np.sin(turns), 0.9 + 0 * rim])
        points[:3] += (0.0, 0.0, 0.4 * radius)  # on no surface
        points += rng.normal(0, 0.03 * radius, points.shape)
        return Part(link, cloud=PointCloud(points.astype(np.float32)), name="knob")

    places = [(f"link_{k}", 0.1 * k, 0.02) for k in range(1, 5)]
    parts = (*(knob(*p) for p in places), knob("link_5", 0.6, 0.03))
    monkeypatch.setattr(part_tasks, "parts_of", lambda _: parts)
    names = ("link_0", *(p.link for p in parts))
    turning = Joint("a", "continuous", "link_0", "link_1", (0, 0, 1), (0.1, 0, 0.9))
    others = [Joint(n, "revolute", "link_0", n, (0, 1, 0), (0, 0, 0), 0, 2) for n in names[2:]]
    tree = KinematicTree(names, (turning, *others))
    found = part_tasks.joints_like(cast(Any, None), tree, "link_1", frozenset())
    assert [(j.child, j.type) for j in found] == [(n, "continuous") for n in names[2:5]]
    assert [j.origin[0] for j in found] == pytest.approx([0.2, 0.3, 0.4], abs=0.003)
