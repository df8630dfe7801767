"""Equal parts that move differently, and their fix."""

from dataclasses import replace

import numpy as np
import pytest

from model.core.joint import Joint
from model.validation.report import ValidationReport
from model.validation.runner import validate
from tests.builders import box, linked, part

W = 0.02
BODY = part(
    "link_0",
    box([-0.5, 0, 0], [-0.5 + W, 0.5, 1]),
    box([0.5 - W, 0, 0], [0.5, 0.5, 1]),
    box([-0.5, 0.5 - W, 0], [0.5, 0.5, 1]),
    box([-0.5, 0, 0], [0.5, 0.5, W]),
    name="carcass",
)


def drawer(link: str, low: float):
    """0.94 wide and 0.2 high, with a knob on the left."""
    front = box([-0.47, -W, low], [0.47, 0, low + 0.2])
    floor = box([-0.47, 0, low], [0.47, 0.4, low + 0.01])
    return part(link, front, floor, box([-0.3, -0.06, low + 0.08], [-0.26, -W, low + 0.12]))


def door(link: str, side: float):
    """Half of the front, with a knob beside the middle."""
    xs, at = sorted((side * 0.005, side * 0.5)), sorted((side * 0.04, side * 0.08))
    panel = box([xs[0], -W - 0.002, 0.5], [xs[1], -0.002, 1])
    return part(link, panel, box([at[0], -0.06, 0.7], [at[1], -W, 0.74]))


OUT = Joint("first", "prismatic", "link_0", "link_1", (0, -1, 0), lower=0, upper=0.3)
SIDEWAYS = Joint("second", "prismatic", "link_0", "link_2", (1, 0, 0), lower=0, upper=0.3)
LEFT = Joint(
    "left", "revolute", "link_0", "link_1", (0, 0, -1), (-0.5, -0.002, 0.7), lower=0, upper=1.5
)
RIGHT = replace(LEFT, name="right", child="link_2", axis=(0, 0, 1), origin=(0.5, -0.002, 0.7))


def checked(*joints: Joint, parts) -> ValidationReport:
    return validate(linked(joints, BODY, *parts), physics=False)


def unlike(report: ValidationReport) -> dict[str, str]:
    return {j.joint: f.message for j in report.joints for f in j.findings if f.kind == "siblings"}


def test_a_drawer_that_moves_across_its_twin_moves_like_it_at_one_press() -> None:
    parts = drawer("link_1", 0.05), drawer("link_2", 0.27)
    report = checked(OUT, SIDEWAYS, parts=parts)
    assert unlike(report) == {"second": "Moves across part 1, which has the same shape."}
    (fix,) = (f for f in report.of("second").fixes if f.kind == "like")
    assert (fix.joint.name, fix.joint.child, fix.value) == ("second", "link_2", "part 1")
    assert fix.joint.axis == pytest.approx(OUT.axis)
    assert not unlike(checked(OUT, fix.joint, parts=parts))
    still = Joint("second", "fixed", "link_0", "link_2")
    assert set(unlike(checked(OUT, still, parts=parts))) == {"second"}


def test_mirrored_doors_turn_about_mirrored_edges() -> None:
    parts = door("link_1", -1), door("link_2", 1)
    assert not unlike(checked(LEFT, RIGHT, parts=parts))
    report = checked(LEFT, replace(RIGHT, axis=(0, 0, -1)), parts=parts)  # into the carcass
    assert unlike(report) == {"right": "Moves otherwise than part 1, which has the same shape."}
    fix = next(f for f in report.of("right").fixes if f.kind == "like")
    np.testing.assert_allclose(fix.joint.axis, RIGHT.axis, atol=1e-6)
    np.testing.assert_allclose(fix.joint.origin[:2], RIGHT.origin[:2], atol=0.01)


def test_parts_of_another_shape_may_move_as_they_like() -> None:
    named = (
        replace(p, name=n)
        for p, n in ((drawer("link_1", 0.05), "drawer"), (drawer("link_2", 0.27), "door"))
    )
    assert not unlike(checked(OUT, SIDEWAYS, parts=named)), "a drawer's front is no door"
    low = part("link_2", box([-0.47, -W, 0.27], [0.47, 0.1, 0.33]))
    assert not unlike(checked(OUT, SIDEWAYS, parts=(drawer("link_1", 0.05), low)))
