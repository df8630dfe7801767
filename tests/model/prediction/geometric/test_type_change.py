"""A joint whose type a person changes gets what a joint of the new type has."""

import math
from dataclasses import replace

import numpy as np
import pytest

from model.core.articulated_object import SegmentedObject
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from model.prediction.geometric.roles import change_joint_type
from tests.model.prediction.geometric.archetypes import (
    THINGS,
    Thing,
    Truth,
    box,
    carcass,
    join,
    tray,
)

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
    joint = change_joint_type(made.segmented(names=names), tree, wrong.child, truth.type)  # type: ignore[arg-type]
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
    drawer = change_joint_type(made.segmented(), mistaken(made), "link_drawer", "prismatic")
    assert drawer.axis == pytest.approx((-1, 0, 0), abs=1e-6)
    assert drawer.lower == 0.0
    assert drawer.upper == pytest.approx(0.8 * 0.45, abs=0.05), "within its rails"


def in_a_case(width: float, height: float) -> Thing:
    """A drawer with a tray behind its front, which is the whole front of a case, facing -x."""
    inner = (0.5, width - 0.04, height - 0.04)
    drawer = join(
        tray((0.26, 0, height / 2), inner), box((-0.01, 0, height / 2), (0.02, *inner[1:]))
    )
    case = carcass((0.27, 0, height / 2), (0.54, width, height))
    parts = {"base": ("furniture_body", case), "drawer": ("drawer", drawer)}
    return Thing("StorageFurniture", parts, {"drawer": Truth("prismatic", (1, 0, 0))})


@pytest.mark.parametrize("names", [True, False])
def test_a_drawer_that_is_made_to_turn_opens_at_its_front(names: bool) -> None:
    """It was hinged on a side in depth, or at the back, where nothing can turn."""
    for made, upright in ((in_a_case(0.8, 0.3), False), (in_a_case(0.3, 0.7), True)):
        slide = replace(SLID, axis=(-1.0, 0.0, 0.0), child="link_drawer")
        tree = KinematicTree(("link_base", "link_drawer"), (slide,))
        front = change_joint_type(made.segmented(names=names), tree, "link_drawer", "revolute")
        low, high = np.asarray(made.parts["drawer"][1].bounds)
        assert front.origin[0] == pytest.approx(low[0], abs=0.01), "at the face"
        assert abs(front.axis[2 if upright else 1]) > 0.99
        if upright:
            assert min(abs(front.origin[1] - e) for e in (low[1], high[1])) < 0.01
        else:
            assert front.origin[2] == pytest.approx(low[2], abs=0.01)
        arm = 0.5 * (low + high) - front.origin
        assert np.cross(front.axis, arm)[0] < 0, "positive q opens"
        assert front.lower == 0.0 and front.upper == pytest.approx(1.6, abs=0.1)


def test_a_large_front_opens_and_does_not_rock() -> None:
    """One that fills half of a cupboard, alone in it."""
    made = THINGS["cabinet"]()
    kept = [p for p in made.segmented(names=False).parts if p.link in ("link_base", "link_drawer")]
    tree = KinematicTree(("link_base", "link_drawer"), (mistaken(made).joint_of["link_drawer"],))
    slide = replace(tree.joint_of["link_drawer"], type="prismatic", axis=(-1, 0, 0), upper=0.3)
    front = change_joint_type(
        SegmentedObject("cupboard", tuple(kept)), tree.with_joint(slide), "link_drawer", "revolute"
    )
    assert front.lower == 0.0 and front.upper is not None and front.upper > 1.0


def test_a_joint_that_turns_keeps_its_line_without_limits() -> None:
    made = THINGS["cabinet"]()
    follows = replace(mistaken(made).joint_of["link_left"], type="revolute", axis=(0, 0, 1))
    tree = mistaken(made).with_joint(replace(follows, mimic=Mimic("joint_right", -1.0)))
    free = change_joint_type(made.segmented(), tree, "link_left", "continuous")
    assert (free.axis, free.origin, free.mimic) == (follows.axis, follows.origin, None)
    again = change_joint_type(made.segmented(), tree.with_joint(free), "link_left", "revolute")
    assert (again.axis, again.origin) == (follows.axis, follows.origin)
    assert (again.lower, again.upper) == (0.0, math.pi / 2)
    assert not change_joint_type(made.segmented(), tree, "link_left", "fixed").moves


def test_both_joints_of_a_part_are_about_that_part() -> None:
    made = THINGS["cabinet"]()
    tree = mistaken(made)
    turns = replace(tree.joint_of["link_drawer"], parent="helper_drawer")
    first = Joint("first", "revolute", "link_base", "helper_drawer", (0, 0, 1), lower=0, upper=1)
    kept = tuple(j for j in tree.joints if j.child != "link_drawer")
    tree = KinematicTree((*tree.links, "helper_drawer"), (*kept, first, turns))
    slides = change_joint_type(made.segmented(), tree, "helper_drawer", "prismatic")
    assert (slides.name, slides.child) == ("first", "helper_drawer")
    assert slides.axis == pytest.approx((-1, 0, 0), abs=1e-6)
