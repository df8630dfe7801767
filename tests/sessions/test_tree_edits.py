"""Edits keep a tree a tree, and rooting it elsewhere keeps the mechanism."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from model.core.errors import KinematicsError
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree, replace_joint, without_link

unit = st.floats(-1, 1, allow_nan=False)


@st.composite
def trees(draw) -> KinematicTree:
    count = draw(st.integers(1, 7))
    joints = []
    for i in range(1, count):
        axis = draw(st.tuples(unit, unit, unit).filter(lambda a: np.linalg.norm(a) > 0.1))
        kind = draw(st.sampled_from(["revolute", "continuous", "prismatic", "fixed"]))
        parent = draw(st.integers(0, i - 1))
        leader = draw(st.sampled_from([None, *(j.name for j in joints if j.moves)]))
        joints.append(
            Joint(
                f"j{i}",
                kind,
                f"link_{parent}",
                f"link_{i}",
                axis,
                draw(st.tuples(unit, unit, unit)),
                -0.3,
                0.9,
                Mimic(leader, 0.5, 0.1) if leader and kind != "fixed" else None,
            )
        )
    return KinematicTree(tuple(f"link_{i}" for i in range(count)), tuple(joints))


@given(trees(), st.data())
def test_rooting_elsewhere_keeps_all_relative_poses(tree, data):
    link = data.draw(st.sampled_from(tree.links))
    q = {j.name: data.draw(unit) for j in tree.joints if j.moves}
    other = tree.rerooted(link)
    assert other.root == link
    before, after = tree.pose(q), other.pose(q)
    for name in tree.links:
        relative_before = np.linalg.inv(before[link]) @ before[name]
        relative_after = np.linalg.inv(after[link]) @ after[name]
        np.testing.assert_allclose(relative_after, relative_before, atol=1e-9)
    assert {j.name: (j.lower, j.upper) for j in other.joints} == {
        j.name: (j.lower, j.upper) for j in tree.joints
    }


@given(trees(), st.data())
def test_rooting_there_and_back_changes_nothing(tree, data):
    link = data.draw(st.sampled_from(tree.links))
    back = tree.rerooted(link).rerooted(tree.root)
    assert back.links == tree.links
    for a, b in zip(back.joints, tree.joints, strict=True):
        assert a == b


@given(trees().filter(lambda t: len(t.links) > 1), st.data())
def test_any_new_parent_gives_a_tree(tree, data):
    child = data.draw(st.sampled_from([j.child for j in tree.joints]))
    parent = data.draw(st.sampled_from([n for n in tree.links if n != child]))
    after = replace_joint(tree, replace(tree.joint_of[child], parent=parent))
    assert after.joint_of[child].parent == parent
    assert after.root == tree.root
    moved = {n for n in tree.joint_of if after.joint_of[n].parent != tree.joint_of[n].parent}
    assert moved <= {child, parent}


@given(trees(), st.data())
def test_a_link_taken_out_leaves_the_other_joints_alone(tree, data):
    link = data.draw(st.sampled_from(tree.links))
    after = without_link(tree, link)
    if len(tree.links) == 1:
        assert after is None
        return
    assert after is not None
    assert set(after.links) == set(tree.links) - {link}
    for j in after.joints:
        old = tree.joint_of[j.child]
        assert (j.name, j.type, j.axis, j.origin) == (old.name, old.type, old.axis, old.origin)


def test_a_parent_from_below_is_lifted(cabinet):
    after = replace_joint(cabinet, replace(cabinet.joint_of["link_1"], parent="link_2"))
    assert after.joint_of["link_2"].parent == "link_0"
    assert after.joint_of["link_1"].parent == "link_2"


def test_a_new_name_reaches_the_followers(cabinet):
    after = replace_joint(cabinet, replace(cabinet.joint_of["link_3"], name="tray"))
    assert after.joint_of["link_4"].mimic == Mimic("tray", 2.0)
    assert after.pose({"tray": 0.2}).keys() == cabinet.pose({"slide": 0.2}).keys()


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"name": "turn"}, "'turn' is there twice"),
        ({"parent": "link_9"}, "'link_9' doesn't exist"),
        ({"child": "link_0", "parent": "link_2"}, "'link_0' is the root"),
        ({"child": "link_9"}, "no joint moves a link 'link_9'; links with a joint: link_1"),
    ],
)
def test_what_is_wrong_is_named(cabinet, change, words):
    with pytest.raises(KinematicsError, match=words):
        replace_joint(cabinet, replace(cabinet.joint_of["link_1"], **change))


def test_a_leader_that_stops_moving_is_refused(cabinet):
    with pytest.raises(KinematicsError, match=r"'spin' mimics 'slide'.*no moving joint"):
        replace_joint(cabinet, replace(cabinet.joint_of["link_3"], type="fixed"))


def test_an_unknown_root_is_refused(cabinet):
    with pytest.raises(KinematicsError, match="no link 'door'"):
        cabinet.rerooted("door")


def test_the_way_up(cabinet):
    assert cabinet.path_to_root("link_2") == ("link_2", "link_1")
    assert cabinet.path_to_root("link_0") == ()
