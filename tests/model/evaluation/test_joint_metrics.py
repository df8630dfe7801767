"""Each wrong answer loses exactly the figures that it should."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.core.articulated_object import ArticulatedObject, Part
from model.core.geometry import PointCloud
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.evaluation.joint_metrics import (
    ObjectScore,
    axis_angle,
    interval_iou,
    point_to_line,
    score_object,
)
from model.evaluation.summary import summarise

DIAGONAL = math.sqrt(3.0)


def part(link: str) -> Part:
    corners = np.array(np.meshgrid((0, 1), (0, 1), (0, 1))).reshape(3, -1).T
    return Part(link, cloud=PointCloud(corners.astype(np.float32)))


def oracle() -> ArticulatedObject:
    """A unit cube with a door, a knob on it, a drawer, and a cap that turns and slides."""
    joints = (
        Joint("door", "revolute", "link_0", "link_1", (0, 0, 1), (1, 0, 0), 0.0, 1.6),
        Joint("knob", "continuous", "link_1", "link_2", (1, 0, 0), (0, 0.5, 0.5)),
        Joint("drawer", "prismatic", "link_0", "link_3", (-1, 0, 0), (0, 0, 0), 0.0, 0.5),
        Joint("up", "prismatic", "link_0", "helper_4", (0, 0, 1), (0.5, 0.5, 1), 0.0, 0.2),
        Joint("turn", "continuous", "helper_4", "link_4", (0, 0, 1), (0.5, 0.5, 1)),
    )
    links = ("link_0", "link_1", "link_2", "link_3", "link_4", "helper_4")
    parts = tuple(part(f"link_{i}") for i in range(5))
    return ArticulatedObject("cube", parts, KinematicTree(links, joints), "Cube")


def score(tree: KinematicTree | None) -> ObjectScore:
    return score_object(oracle(), tree)


def joint_score(scored: ObjectScore, child: str):
    return next(j for j in scored.joints if j.child == child)


def without(tree: KinematicTree, name: str) -> KinematicTree:
    """The joint called ``name`` becomes fixed."""
    return tree.with_joint(replace(tree.by_name[name], type="fixed"))


def test_the_truth_scores_full_marks() -> None:
    scored = score(oracle().tree)
    s = summarise([scored])
    assert scored.usable and scored.tree_right and not scored.extra
    whole, none = "tc type_precision parent tree usable usable_joints", "apd apd_all opd ald dld"
    assert {s[name] for name in whole.split()} == {1}
    assert {s[name] for name in (*none.split(), "opd_line", "opd_line_all")} == {0.0}
    assert (s.joints, s.missing, s.extra, s.failed) == (5, 0, 0, 0)


def test_flipped_axes_with_their_limits_are_the_same_motion() -> None:
    tree = oracle().tree
    flipped = KinematicTree(tree.links, tuple(j.flipped() for j in tree.joints))
    scored = score(flipped)
    assert scored.usable
    assert summarise([scored])["ald"] == 0.0


def test_an_axis_flipped_without_its_limits_loses_the_range_alone() -> None:
    tree = oracle().tree
    door = tree.by_name["door"]
    wrong = tree.with_joint(replace(door, axis=(0, 0, -1)))
    found = joint_score(score(wrong), "link_1")
    assert found.type_right and found.apd == 0.0 and found.opd_line == 0.0
    assert found.ald == pytest.approx(1.6) and not found.range_right and not found.usable


def test_a_negative_axis_gives_no_nan() -> None:
    truth = oracle()
    back = Joint("x", "revolute", "link_0", "link_1", (-1, 0, 0), (0, 0, 0), 0, 1)
    same = axis_angle(back.axis, (1.0, 0.0, 0.0))
    assert same == 0.0
    near = axis_angle((-1.0, 0.0, 0.0), (-1.0, 1e-9, 0.0))
    assert math.isfinite(near) and near == pytest.approx(1e-9, rel=1e-3)
    scored = score_object(truth, truth.tree.with_joint(back))
    assert joint_score(scored, "link_1").apd == pytest.approx(math.pi / 2)


def test_parallel_hinges_half_a_metre_apart_are_not_the_same() -> None:
    tree = oracle().tree
    for shift in ((0.5, 0, 0), (0, 0.5, 0), (0.3, 0.4, 0)):
        moved = replace(tree.by_name["door"], origin=tuple(np.add((1, 0, 0), shift)))
        found = joint_score(score(tree.with_joint(moved)), "link_1")
        assert found.opd == pytest.approx(0.5)
        assert found.opd_line == pytest.approx(0.5 / DIAGONAL)
        assert found.apd == 0.0 and found.ald == 0.0 and not found.usable


def test_sliding_the_origin_along_the_axis_costs_only_the_papers_distance() -> None:
    tree = oracle().tree
    moved = replace(tree.by_name["door"], origin=(1, 0, 0.7))
    found = joint_score(score(tree.with_joint(moved)), "link_1")
    assert found.opd == pytest.approx(0.7) and found.opd_line == pytest.approx(0.0)
    assert found.usable


def test_a_drawers_origin_means_nothing() -> None:
    tree = oracle().tree
    moved = replace(tree.by_name["drawer"], origin=(9, 9, 9))
    found = joint_score(score(tree.with_joint(moved)), "link_3")
    assert found.opd is None and found.opd_line is None and found.usable


def test_a_wrong_type_loses_type_and_limits() -> None:
    tree = oracle().tree
    wrong = replace(tree.by_name["door"], type="continuous")
    scored = score(tree.with_joint(wrong))
    found = joint_score(scored, "link_1")
    assert not found.type_right and found.ald is None and found.apd == 0.0 and not found.usable
    assert summarise([scored])["tc"] == pytest.approx(4 / 5)


@pytest.mark.parametrize("name", ["door", "knob", "drawer", "up", "turn"])
def test_a_missing_joint_counts_against(name: str) -> None:
    scored = score(without(oracle().tree, name))
    s = summarise([scored])
    assert s["tc"] == pytest.approx(4 / 5) and s.missing == 1 and not scored.usable
    assert s["apd"] == 0.0 and s["apd_all"] == pytest.approx(math.pi / 2 / 5)
    assert s["type_precision"] == 1.0


def test_an_extra_joint_counts_against() -> None:
    truth = oracle()
    fixed = ArticulatedObject("cube", truth.parts, without(truth.tree, "drawer"), "Cube")
    scored = score_object(fixed, truth.tree)
    assert scored.extra == (("link_3", "prismatic"),)
    assert all(j.usable for j in scored.joints) and not scored.usable
    s = summarise([scored])
    assert s["tc"] == 1.0 and s["type_precision"] == pytest.approx(4 / 5) and s.extra == 1


def test_a_screw_reported_as_one_turn_misses_its_slide() -> None:
    truth = oracle()
    joints = tuple(j for j in truth.tree.joints if j.name not in ("up", "turn"))
    turn = replace(truth.tree.by_name["turn"], parent="link_0")
    tree = KinematicTree(tuple(x for x in truth.tree.links if x != "helper_4"), (*joints, turn))
    scored = score(tree)
    types = {(j.true_type, j.type) for j in scored.joints if j.child == "link_4"}
    assert types == {("prismatic", "missing"), ("continuous", "continuous")}


def test_a_wrong_parent_loses_the_tree() -> None:
    tree = oracle().tree
    wrong = replace(tree.by_name["knob"], parent="link_0")
    scored = score(tree.with_joint(wrong))
    found = joint_score(scored, "link_2")
    assert not found.parent_right and not scored.tree_right and not found.usable
    assert found.type_right and summarise([scored])["parent"] == pytest.approx(4 / 5)


@pytest.mark.parametrize(
    ("upper", "right"), [(1.6, True), (1.3, True), (0.9, True), (0.7, False), (3.3, False)]
)
def test_ranges(upper: float, right: bool) -> None:
    tree = oracle().tree
    found = joint_score(
        score(tree.with_joint(replace(tree.by_name["door"], upper=upper))), "link_1"
    )
    assert found.range_right is right
    assert found.ald == pytest.approx(abs(upper - 1.6) / 2)


def test_a_buttons_small_travel_is_right_by_size() -> None:
    truth = oracle()
    press = replace(truth.tree.by_name["drawer"], upper=0.004)
    small = ArticulatedObject("cube", truth.parts, truth.tree.with_joint(press))
    found = score_object(small, truth.tree.with_joint(replace(press, upper=0.02)))
    assert joint_score(found, "link_3").range_iou == pytest.approx(0.2)
    assert joint_score(found, "link_3").range_right


def test_no_prediction_fails_everything() -> None:
    scored = score_object(oracle(), None, problem="it crashed")
    s = summarise([scored])
    assert (s["tc"], s["usable"], s["tree"], s.missing, s.failed) == (0.0, 0.0, 0.0, 5, 1)
    assert math.isnan(s["apd"]) and s["apd_all"] == pytest.approx(math.pi / 2)
    assert s["opd_line_all"] == 1.0


def test_a_prediction_ten_times_as_large_loses_origins_not_types() -> None:
    tree = oracle().tree
    big = KinematicTree(
        tree.links, tuple(replace(j, origin=tuple(np.multiply(j.origin, 10))) for j in tree.joints)
    )
    s = summarise([score(big)])
    assert s["tc"] == 1.0 and s["apd"] == 0.0 and s["opd_line"] > 1.0 and s["usable"] == 0.0


def test_y_up_axes_lose_axes_not_types() -> None:
    tree = oracle().tree
    turned = KinematicTree(
        tree.links,
        tuple(replace(j, axis=(j.axis[0], j.axis[2], -j.axis[1])) for j in tree.joints),
    )
    s = summarise([score(turned)])
    assert s["tc"] == 1.0 and s["usable"] == 0.0
    assert s["apd"] == pytest.approx(3 / 5 * math.pi / 2)


angle = st.floats(-1, 1)
vector = st.tuples(angle, angle, angle).filter(lambda v: np.linalg.norm(v) > 0.1)


def pliers(second: float = 1.0) -> ArticulatedObject:
    """Two handles; ``second`` is the size of the one that moves."""
    corners = np.array(np.meshgrid((0, 1), (0, 1), (0, 1))).reshape(3, -1).T
    parts = tuple(
        Part(f"link_{i}", cloud=PointCloud((size * corners).astype(np.float32)))
        for i, size in enumerate((1.0, second))
    )
    joint = Joint("pin", "revolute", "link_0", "link_1", (0, 0, 1), (0.5, 0.5, 0), 0.0, 0.8)
    return ArticulatedObject("pliers", parts, KinematicTree(("link_0", "link_1"), (joint,)))


def test_either_half_of_pliers_may_be_the_base_but_no_door_may_be_a_cabinets() -> None:
    for size, usable in ((1.0, True), (0.6, False)):
        truth = pliers(size)
        other = truth.tree.rerooted("link_1")
        assert other.root == "link_1"
        assert other.rerooted("link_0") == truth.tree
        scored = score_object(truth, other)
        assert scored.usable is usable
        assert bool(scored.extra) is not usable


@pytest.mark.parametrize("degrees, right", [(360, True), (310, True), (180, False)])
def test_a_knob_that_turns_almost_round_is_as_good_as_continuous(degrees, right) -> None:
    truth = oracle()
    upper = math.radians(degrees)
    knob = replace(truth.tree.by_name["knob"], type="revolute", lower=0.0, upper=upper)
    scored = score(truth.tree.with_joint(knob))
    assert joint_score(scored, "link_2").type_right is right
    assert scored.usable is right


@given(a=vector, b=vector)
def test_axis_angle_is_symmetric_and_blind_to_sign(a, b) -> None:
    found = axis_angle(a, b)
    assert 0.0 <= found <= math.pi / 2 + 1e-12
    assert found == pytest.approx(axis_angle(b, a))
    assert found == pytest.approx(axis_angle(np.negative(a), b))


@given(point=vector, origin=vector, axis=vector, along=st.floats(-5, 5))
def test_distance_to_a_line_ignores_motion_along_it(point, origin, axis, along: float) -> None:
    axis = np.asarray(axis) / np.linalg.norm(axis)
    here = point_to_line(point, origin, axis)
    assert here == pytest.approx(point_to_line(point + along * axis, origin, axis), abs=1e-9)
    assert here <= np.linalg.norm(np.subtract(point, origin)) + 1e-9


def test_interval_iou() -> None:
    assert interval_iou((0, 1), (0, 1)) == 1.0
    assert interval_iou((0, 1), (2, 3)) == 0.0
    assert interval_iou((0, 2), (1, 3)) == pytest.approx(1 / 3)
    assert interval_iou((0, 0), (0, 0)) == 1.0
