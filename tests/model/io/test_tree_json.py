import json

import pytest

from model.core.errors import KinematicsError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.tree_json import tree_from_json, tree_json_problems, tree_to_json

TREE = KinematicTree(
    ("knob", "body", "door", "handle"),
    (
        Joint("turn", "continuous", "body", "knob"),
        Joint("hinge", "revolute", "body", "door", lower=0, upper=1),
        Joint("fix", "fixed", "door", "handle"),
    ),
)


def test_the_tree_is_nested_and_has_no_numbers():
    data = tree_to_json(TREE)
    assert data["part"] == "body" and "joint_type" not in data
    assert [c["part"] for c in data["children"]] == ["knob", "door"]
    assert data["children"][1]["children"][0] == {
        "part": "handle",
        "joint_type": "fixed",
        "joint_name": "fix",
        "children": [],
    }
    assert not any(c.isdigit() for c in json.dumps(data))


def test_it_reads_back():
    node = tree_from_json(json.dumps(tree_to_json(TREE)))
    edges = {(n.part, n.joint_type, n.joint_name, parent) for n, parent in node.walk()}
    assert edges == {
        ("body", None, None, None),
        ("knob", "continuous", "turn", "body"),
        ("door", "revolute", "hinge", "body"),
        ("handle", "fixed", "fix", "door"),
    }
    assert tree_json_problems(tree_to_json(TREE), TREE) == []


def test_joint_names_may_be_left_out_and_the_root_may_be_fixed():
    data = {
        "part": "body",
        "joint_type": "fixed",
        "children": [{"part": "a", "joint_type": "fixed"}],
    }
    assert tree_from_json(data).children[0].joint_name is None


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ("{", ["not JSON"]),
        ([], ["expected an object"]),
        ({"part": "a", "children": [{"part": "b"}]}, ["'b'", "joint_type", "revolute"]),
        ({"part": "a", "joint_type": "revolute"}, ["root has no joint"]),
        ({"part": 3, "children": "x"}, ["must be a name", "must be a list"]),
        ({"part": "a", "limit": 3}, ["unknown keys limit"]),
        (
            {"part": "a", "children": [{"part": "a", "joint_type": "fixed"}, 7]},
            ["'a' is there twice", "'7'"],
        ),
    ],
)
def test_bad_trees_say_all_that_is_wrong(data, words):
    with pytest.raises(KinematicsError) as caught:
        tree_from_json(data)
    for word in words:
        assert word in str(caught.value)


def test_a_tree_without_end_is_refused():
    data: dict = {"part": "a"}
    for i in range(400):
        data = {"part": f"p{i}", "joint_type": "fixed", "children": [data]}
    data = {"part": "root", "children": [data]}
    with pytest.raises(KinematicsError, match="deeper"):
        tree_from_json(data)


def test_disagreement_with_the_tree_is_listed():
    data = tree_to_json(TREE)
    data["children"][1]["joint_type"] = "prismatic"
    data["children"][0]["joint_name"] = "twist"
    data["children"][1]["children"][0]["part"] = "grip"
    assert tree_json_problems(data, TREE) == [
        "link 'handle' is not in the JSON",
        "'knob': the JSON calls the joint 'twist', the tree 'turn'",
        "'door': the JSON says prismatic, the tree revolute",
        "part 'grip' of the JSON is no link",
    ]
