"""A joint whose type a person changes gets what a joint of the new type has."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from archetypes import THINGS, Thing

from model.geometric.retyping import retyped
from model.kinematics.articulated_object import SegmentedObject
from model.kinematics.joint import Joint, Mimic
from model.kinematics.tree import KinematicTree

SWUNG = Joint("j", "revolute", "link_base", "link", (0, 0, 1), (0.3, 0.2, 0.0), 0.0, 1.57)
SLID = Joint("j", "prismatic", "link_base", "link", (1, 0, 0), (0.0, 0.0, 0.0), 0.0, 0.3)


def mistaken(thing: Thing) -> KinematicTree:
    """Slides that are taken for hinges, and what turns for a slide."""
    joints = []
    for key, truth in thing.truth.items():
        wrong = SWUNG if truth.type == "prismatic" else SLID
        ends = {"parent": f"link_{truth.parent}", "child": f"link_{key}"}
        joints.append(replace(wrong, name=f"joint_{key}", **ends))
    others = [f"link_{k}" for k in thing.parts if k not in thing.truth and k != "base"]
    stuck = [Joint(f"joint_{k}", "fixed", "link_base", k) for k in others]
    return KinematicTree(tuple(f"link_{k}" for k in thing.parts), (*joints, *stuck))


@pytest.mark.parametrize("names", [True, False])
@pytest.mark.parametrize(
    ("thing", "part"),
    [
        ("cabinet", "left"),
        ("laptop", "screen"),
        ("sliding_window", "a"),
        ("suitcase", "handle"),
        ("pen", "cap"),
        ("globe", "sphere"),
        ("washer", "knob"),
    ],
)
def test_axis_place_and_range_fit_the_new_type(thing: str, part: str, names: bool) -> None:
    made = THINGS[thing]()
    truth, tree = made.truth[part], mistaken(made)
    wrong = tree.joint_of[f"link_{part}"]
    joint = retyped(made.segmented(names=names), tree, wrong.child, truth.type)  # type: ignore[arg-type]
    assert (joint.name, joint.parent, joint.child) == (wrong.name, wrong.parent, wrong.child)
    assert joint.type == truth.type
    assert abs(np.dot(joint.axis, truth.axis)) > 0.99
    if truth.type != "prismatic" and truth.point is not None:
        off = np.cross(np.subtract(joint.origin, truth.point), truth.axis)
        assert np.linalg.norm(off) < 0.05
    if joint.limited:
        assert joint.lower is not None
        assert joint.upper is not None
        assert joint.lower <= 0.0 < joint.upper < math.pi


def test_a_drawer_taken_for_a_door_comes_out_to_the_front() -> None:
    made = THINGS["cabinet"]()
    drawer = retyped(made.segmented(), mistaken(made), "link_drawer", "prismatic")
    assert drawer.axis == pytest.approx((-1, 0, 0), abs=1e-6)
    assert drawer.lower == 0.0
    assert drawer.upper == pytest.approx(0.8 * 0.45, abs=0.05), "within its rails"


def test_a_large_front_opens_and_does_not_rock() -> None:
    """One that fills half of a cupboard, alone in it."""
    made = THINGS["cabinet"]()
    kept = [p for p in made.segmented(names=False).parts if p.link in ("link_base", "link_drawer")]
    tree = KinematicTree(("link_base", "link_drawer"), (mistaken(made).joint_of["link_drawer"],))
    slide = replace(tree.joint_of["link_drawer"], type="prismatic", axis=(-1, 0, 0), upper=0.3)
    front = retyped(
        SegmentedObject("cupboard", tuple(kept)), tree.with_joint(slide), "link_drawer", "revolute"
    )
    assert front.lower == 0.0 and front.upper is not None and front.upper > 1.0


def test_a_joint_that_turns_keeps_its_line_without_limits() -> None:
    made = THINGS["cabinet"]()
    follows = replace(mistaken(made).joint_of["link_left"], type="revolute", axis=(0, 0, 1))
    tree = mistaken(made).with_joint(replace(follows, mimic=Mimic("joint_right", -1.0)))
    free = retyped(made.segmented(), tree, "link_left", "continuous")
    assert (free.axis, free.origin, free.mimic) == (follows.axis, follows.origin, None)
    again = retyped(made.segmented(), tree.with_joint(free), "link_left", "revolute")
    assert (again.axis, again.origin) == (follows.axis, follows.origin)
    assert (again.lower, again.upper) == (0.0, math.pi / 2)
    assert not retyped(made.segmented(), tree, "link_left", "fixed").moves


def test_both_joints_of_a_part_are_about_that_part() -> None:
    made = THINGS["cabinet"]()
    tree = mistaken(made)
    turns = replace(tree.joint_of["link_drawer"], parent="helper_drawer")
    first = Joint("first", "revolute", "link_base", "helper_drawer", (0, 0, 1), lower=0, upper=1)
    kept = tuple(j for j in tree.joints if j.child != "link_drawer")
    tree = KinematicTree((*tree.links, "helper_drawer"), (*kept, first, turns))
    slides = retyped(made.segmented(), tree, "helper_drawer", "prismatic")
    assert (slides.name, slides.child) == ("first", "helper_drawer")
    assert slides.axis == pytest.approx((-1, 0, 0), abs=1e-6)
