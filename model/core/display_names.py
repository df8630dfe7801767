"""Names of links and joints as every screen and message shows them: "door 2", "seat 1: lift"."""

from __future__ import annotations

from collections.abc import Callable

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint
from model.core.tree import KinematicTree, moving_chain

BASE = "base"
UPRIGHT = 0.9
"""Cosine to +z from which an axis counts as upright: about 25 degrees, a choice."""


def link_display_name(link: str, name: str | None, *, root: bool) -> str:
    """Return "door 2", "part 2" without a part name, and other links unchanged.

    Args:
        name: of the link's part, or None.
        root: whether the link is the tree's root, which is the "base" if it is part 0 or no part.
    """
    number = link.removeprefix("link_") if link.startswith("link_") else ""
    named = bool(name) and name != link
    if not number.isdigit():
        return BASE if root and not named else link
    if named:
        return BASE if (name, number) == (BASE, "0") else f"{name} {number}"
    return BASE if root and number == "0" else f"part {number}"


def joint_display_name(
    tree: KinematicTree, child: str, has_part: Callable[[str], bool], part: Callable[[str], str]
) -> str:
    """Return the moved part's name, with the motion where the part has several joints.

    Args:
        child: link that the joint moves.
        has_part: whether a link has a part; helper links between the joints of one part have none.
        part: display name of a part's link.
    """
    chain = moving_chain(tree, child, has_part)
    if len(chain) == 1 or not has_part(chain[-1]):
        return part(child)
    place = chain.index(child)
    words = [_motion_name(tree.joint_of[link]) for link in chain[: place + 1]]
    count = words.count(words[-1])
    return f"{part(chain[-1])}: {words[-1]}" + (f" {count}" if count > 1 else "")


def _motion_name(joint: Joint) -> str:
    upright = abs(joint.axis[2]) >= UPRIGHT
    if not joint.moves:
        return "fixed"
    if not joint.rotates:
        return "lift" if upright else "slide"
    if upright:
        return "swivel"
    return "spin" if joint.type == "continuous" else "tilt"


def display_name(obj: ArticulatedObject, link: str) -> str:
    """Return the display name of a link, or of the joint that moves a helper link."""
    names = {p.link: p.name for p in obj.parts}

    def part(of: str) -> str:
        return link_display_name(of, names.get(of), root=of == obj.tree.root)

    if link in names or link == obj.tree.root:
        return part(link)
    return joint_display_name(obj.tree, link, names.__contains__, part)
