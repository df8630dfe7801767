"""What the panels say of a joint."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from app.server.names import display_text, joint_title, moved_part, part_title
from app.viewer.panels.joint_tree import (
    joint_note,
    range_text,
    tree_html,
)
from model.core.articulated_object import ArticulatedObject, Part, Prediction
from model.core.errors import KinematicsError
from model.core.geometry import PointCloud
from model.core.joint import Joint, Mimic, value_text
from model.core.names import display_name
from model.core.tree import KinematicTree
from model.validation.messages import interval
from sessions.document import Document, PartInfo

DOOR = Joint("j1", "revolute", "link_0", "link_1", (0, 0, 1), lower=0.0, upper=math.radians(94.538))


def tree_rows(tree: KinematicTree, doc: Document) -> list[str]:
    """Depth and text of each row."""
    rows = re.findall(
        r'--depth:(\d)".*?<b>(.*?)</b> <small>(.*?)</small>', tree_html(tree, doc, [], None)
    )
    return [f"{depth} {title} {said}".strip() for depth, title, said in rows]


POINTS = PointCloud(np.zeros((1, 3), np.float32))
TREE = KinematicTree(("link_0", "link_1"), (DOOR,))


def document(joint: Joint = DOOR) -> Document:
    return Document(
        parts=(PartInfo(1, "door"),),
        tree=TREE.with_joint(joint),
        prediction=Prediction(TREE, confidence={"link_1": 0.22}),
    )


def test_the_row_of_a_follower_says_whom_it_follows() -> None:
    follower = Joint("j2", "continuous", "link_0", "link_2", (0, 0, 1), mimic=Mimic("j1", 2.0))
    tree = KinematicTree(("link_0", "link_1", "link_2"), (DOOR, follower))
    rows = tree_rows(tree, replace(document(), tree=tree))
    assert rows[-1].startswith("1 part 2 follows door 1 · continuous")


def test_one_rounding_everywhere() -> None:
    assert range_text(DOOR) == "0 to 94.5°"
    assert interval(DOOR, 0.0, DOOR.upper or 0.0) == "0° to 94.5°"
    assert value_text(0.0905, rotates=False) == "90.5 mm"
    assert value_text(-1e-5, rotates=True) == "0°"
    assert range_text(replace(DOOR, type="prismatic", upper=0.353)) == "0 to 353 mm"


def test_a_refusal_speaks_the_unit_that_is_shown() -> None:
    with pytest.raises(KinematicsError, match="lower limit 0° is above upper limit -20°"):
        replace(DOOR, upper=math.radians(-20))


def test_an_edited_joint_is_called_so() -> None:
    assert "confidence\u00a022\u00a0%" in tree_rows(TREE, document())[1]
    said = tree_rows(TREE, document(replace(DOOR, upper=1.0)))[1]
    assert "confidence" not in said
    assert "edited" in said
    note = joint_note(replace(DOOR, upper=1.0), document(), [])
    assert note.startswith("Edited. The gray arrow is the predicted axis")


def test_odd_ranges_are_told() -> None:
    far = replace(DOOR, lower=math.radians(30), upper=math.radians(700))
    note = joint_note(far, document(far), [])
    assert "exceeds one turn" in note
    assert "outside the range" in note
    assert "⚠ range" in tree_rows(TREE.with_joint(far), document(far))[1]
    assert "⚠" not in joint_note(DOOR, document(), [])


def test_the_root_is_the_base() -> None:
    assert tree_rows(TREE, document())[0] == "0 base"
    read = replace(document(), parts=(PartInfo(0, "link_0"), PartInfo(1, "door")))
    assert tree_rows(TREE, read)[0] == "0 base"


def test_a_part_is_called_the_same_everywhere() -> None:
    knob = Joint("j2", "continuous", "link_1", "link_2", (0, 0, 1))
    tree = KinematicTree(("link_0", "link_1", "link_2"), (DOOR, knob))
    doc = Document(
        parts=(PartInfo(0, "base"), PartInfo(1, "door"), PartInfo(2)),
        tree=tree,
        prediction=Prediction(tree, notes={"link_2": "turns beside link_1, as joint_link_2"}),
    )
    assert [part_title(doc, link) for link in tree.links] == ["base", "door 1", "part 2"]
    assert joint_note(knob, doc, []) == "*turns beside door 1, as joint&#95;link&#95;2*"
    assert (
        display_text(doc, "link_2 isn't in parts/link_2.ply") == "part 2 isn't in parts/link_2.ply"
    )
    assert [joint_title(doc, j.child) for j in tree.joints] == ["door 1", "part 2"]
    parts = tuple(Part(p.link, cloud=POINTS, name=p.name) for p in doc.parts)
    obj = ArticulatedObject("cupboard", parts, tree)
    assert [display_name(obj, link) for link in tree.links] == ["base", "door 1", "part 2"]


def test_the_joints_of_one_part_are_told_apart() -> None:
    """A seat that rises and turns has a helper link between, which no screen names."""
    rises = Joint("rises", "prismatic", "link_0", "helper_1", (0, 0, 1), lower=0.0, upper=0.1)
    turns = Joint("turns", "continuous", "helper_1", "link_1", (0, 0, 1))
    lever = Joint("j2", "revolute", "link_1", "link_2", (1, 0, 0), lower=0.0, upper=0.3)
    tree = KinematicTree(("link_0", "helper_1", "link_1", "link_2"), (rises, turns, lever))
    parts = (PartInfo(0, "base"), PartInfo(1, "seat"), PartInfo(2, "lever"))
    sure = {"link_1": 0.71, "link_2": 0.45}
    doc = Document(parts=parts, tree=tree, prediction=Prediction(tree, confidence=sure))
    first, second = "seat 1: lift", "seat 1: swivel"
    assert [joint_title(doc, j.child) for j in tree.joints] == [first, second, "lever 2"]
    assert [part_title(doc, k) for k in tree.links] == ["base", first, "seat 1", "lever 2"]
    assert moved_part(tree, "helper_1") == "link_1"
    assert display_text(doc, "helper_1 is above link_1") == f"{first} is above seat 1"
    said = tree_rows(tree, doc)
    assert not any("helper" in row for row in said)
    assert said[1:3] == [
        f"1 {first} prismatic 0 to 100 mm · confidence\u00a071\u00a0%",
        f"2 {second} continuous · confidence\u00a071\u00a0%",
    ]
    cloud = tuple(Part(p.link, cloud=POINTS, name=p.name) for p in parts)
    obj = ArticulatedObject("chair", cloud, tree)
    assert [display_name(obj, link) for link in tree.links] == ["base", first, "seat 1", "lever 2"]

    # A helper that carries two parts is the joint of neither.
    both = KinematicTree(tree.links, (rises, turns, replace(lever, parent="helper_1")))
    doc = replace(doc, tree=both)
    assert [joint_title(doc, j.child) for j in both.joints] == ["helper_1", "seat 1", "lever 2"]
