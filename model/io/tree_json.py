"""The kinematic tree as nested JSON without numbers: the paper's first answer block.

``{"part": "base", "children": [{"part": "link_0", "joint_type": "revolute",
"joint_name": "hinge", "children": []}]}``. The root has no joint, hence no ``joint_type``;
``"fixed"``, ``"root"`` and null are read there too. Saved assets have ``affordances`` beside a
joint, the only numbers; see :mod:`model.core.articulated_object`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from model.core.articulated_object import Affordance
from model.core.errors import GeometryError, KinematicsError
from model.core.joint import JOINT_TYPES
from model.core.tree import KinematicTree

_KEYS = {"part", "joint_type", "joint_name", "children", "affordances"}
_ROOT_TYPES = (None, "fixed", "root")
MAX_DEPTH = 200


@dataclass(frozen=True)
class TreeNode:
    """A part and its children.

    Attributes:
        part: link name.
        joint_type: of the joint to its parent; None for the root.
        joint_name: None where the text leaves it out.
    """

    part: str
    joint_type: str | None = None
    joint_name: str | None = None
    children: tuple[TreeNode, ...] = ()

    def walk(self, parent: str | None = None) -> list[tuple[TreeNode, str | None]]:
        """This node and all below it with their parents' parts, parents first."""
        out: list[tuple[TreeNode, str | None]] = [(self, parent)]
        for child in self.children:
            out += child.walk(self.part)
        return out


def tree_to_json(tree: KinematicTree, affordances: Sequence[Affordance] = ()) -> dict[str, Any]:
    """The nested dictionary of ``tree``, children in the joints' order."""

    def node(link: str) -> dict[str, Any]:
        out: dict[str, Any] = {"part": link}
        joint = tree.joint_of.get(link)
        if joint is not None:
            out |= {"joint_type": joint.type, "joint_name": joint.name}
            if here := [a.to_json() for a in affordances if a.joint == joint.name]:
                out["affordances"] = here
        out["children"] = [node(child) for child in tree.children(link)]
        return out

    return node(tree.root)


def tree_from_json(data: str | Mapping[str, Any]) -> TreeNode:
    """Read and check the nested dictionary, or its text.

    Raises:
        KinematicsError: with everything that is wrong.
    """
    problems: list[str] = []
    if isinstance(data, str):
        try:
            data = json.loads(data)
        except (ValueError, RecursionError) as error:
            raise KinematicsError([f"the tree is not JSON: {error}"]) from error
    root = _node(data, problems, "", 0)
    if root is not None:
        nodes = root.walk()
        parts = [n.part for n, _ in nodes]
        names = [n.joint_name for n, _ in nodes if n.joint_name is not None]
        problems += [f"part {p!r} is there twice" for p in _twice(parts)]
        problems += [f"joint {n!r} is there twice" for n in _twice(names)]
    if problems or root is None:
        raise KinematicsError(problems)
    return root


def affordances_in(data: Any) -> tuple[Affordance, ...]:
    """Affordances of a nested dictionary that :func:`tree_from_json` reads.

    Raises:
        GeometryError: where one is wrong.
    """
    out: list[Affordance] = []
    stack = [data]
    while stack:
        node = stack.pop()
        if not isinstance(node, Mapping):
            continue
        listed = node.get("affordances", [])
        if not isinstance(listed, list) or not all(isinstance(a, Mapping) for a in listed):
            part = node.get("part")
            raise GeometryError(f"part {part!r}: 'affordances' must be a list of objects")
        joint, link = str(node.get("joint_name")), str(node.get("part"))
        out += [Affordance.from_json(joint, link, a) for a in listed]
        children = node.get("children", [])
        stack += reversed(children) if isinstance(children, list) else []
    return tuple(out)


def tree_json_problems(data: str | Mapping[str, Any], tree: KinematicTree) -> list[str]:
    """Differences between the JSON and ``tree``."""
    try:
        root = tree_from_json(data)
    except KinematicsError as error:
        return list(error.problems)
    out: list[str] = []
    nodes = root.walk()
    parts = {n.part for n, _ in nodes}
    out += [f"link {link!r} is not in the JSON" for link in tree.links if link not in parts]
    for node, parent in nodes:
        if node.part not in tree.links:
            out.append(f"part {node.part!r} of the JSON is no link")
            continue
        joint = tree.joint_of.get(node.part)
        there = None if joint is None else joint.parent
        if parent != there:
            out.append(f"{node.part!r}: the JSON has parent {parent!r}, the tree {there!r}")
        elif joint is not None:
            if node.joint_type != joint.type:
                out.append(f"{node.part!r}: the JSON says {node.joint_type}, the tree {joint.type}")
            if node.joint_name not in (None, joint.name):
                out.append(
                    f"{node.part!r}: the JSON calls the joint {node.joint_name!r}, "
                    f"the tree {joint.name!r}"
                )
    return out


def _node(data: Any, problems: list[str], parent: str, depth: int) -> TreeNode | None:
    where = f"below {parent!r}" if parent else "at the root"
    if depth > MAX_DEPTH:
        problems.append(f"the tree is deeper than {MAX_DEPTH} parts")
        return None
    if not isinstance(data, Mapping):
        problems.append(f"{where}: expected an object with 'part', got {str(data)[:40]!r}")
        return None
    part = data.get("part")
    if not isinstance(part, str) or not part:
        problems.append(f"{where}: 'part' must be a name, got {part!r}")
        part = ""
    where = f"part {part!r}" if part else where
    unknown = sorted(str(k) for k in set(data) - _KEYS)
    if unknown:
        problems.append(f"{where}: unknown keys {', '.join(unknown)}")
    joint_type, joint_name = data.get("joint_type"), data.get("joint_name")
    if not parent and depth == 0:
        if joint_type not in _ROOT_TYPES:
            problems.append(f"{where}: the root has no joint, but joint_type is {joint_type!r}")
        joint_type = joint_name = None
    elif joint_type not in JOINT_TYPES:
        known = ", ".join(JOINT_TYPES)
        problems.append(f"{where}: joint_type {joint_type!r} is none of {known}")
    if joint_name is not None and not (isinstance(joint_name, str) and joint_name):
        problems.append(f"{where}: joint_name must be a name, got {joint_name!r}")
        joint_name = None
    children = data.get("children", [])
    if not isinstance(children, list | tuple):
        problems.append(f"{where}: 'children' must be a list, got {str(children)[:40]!r}")
        children = []
    below = [_node(child, problems, part or "?", depth + 1) for child in children]
    if not part:
        return None
    return TreeNode(part, joint_type, joint_name, tuple(n for n in below if n is not None))


def _twice(names: list[str]) -> list[str]:
    return sorted({n for n in names if names.count(n) > 1})
