"""What the gate's sentences call parts, lengths and joint values."""

from __future__ import annotations

from collections.abc import Callable

from model.core.articulated_object import ArticulatedObject
from model.core.joint import Joint, value_text
from model.core.tree import KinematicTree, moving_chain

BASE = "base"
ORDINALS = ("first", "second", "third", "fourth", "fifth", "sixth")


def called(link: str, name: str | None, *, root: bool) -> str:
    """A link in people's words: "door 2", without a name "part 2"; other links by their own name.

    Args:
        name: of its part, or None.
        root: whether nothing moves it; unnamed it is the "base", unless it is another part than 0.
    """
    number = link.removeprefix("link_") if link.startswith("link_") else ""
    named = bool(name) and name != link
    if not number.isdigit():
        return BASE if root and not named else link
    if named:
        return BASE if (name, number) == (BASE, "0") else f"{name} {number}"
    return BASE if root and number == "0" else f"part {number}"


def joint_called(
    tree: KinematicTree, child: str, holds: Callable[[str], bool], part: Callable[[str], str]
) -> str:
    """The joint of ``child`` in people's words: as the part that it moves, "door 2", or where that
    has several "door 2, first joint".

    Args:
        holds: whether a link holds a part. part: what people call the part in a link.
    """
    chain = moving_chain(tree, child, holds)
    if len(chain) == 1 or not holds(chain[-1]):
        return part(child)
    place = chain.index(child)
    which = ORDINALS[place] if place < len(ORDINALS) else f"{place + 1}th"
    return f"{part(chain[-1])}, {which} joint"


def title(obj: ArticulatedObject, link: str) -> str:
    """A link in people's words; see :func:`called` and :func:`joint_called`."""
    names = {p.link: p.name for p in obj.parts}

    def part(of: str) -> str:
        return called(of, names.get(of), root=of == obj.tree.root)

    if link in names or link == obj.tree.root:
        return part(link)
    return joint_called(obj.tree, link, names.__contains__, part)


def length(metres: float) -> str:
    """Millimetres, with a decimal where they are few."""
    return f"{1000 * metres:.1f} mm" if metres < 0.01 else f"{1000 * metres:.0f} mm"


def value(joint: Joint, q: float) -> str:
    """Degrees or millimetres."""
    return value_text(q, joint.rotates)


def interval(joint: Joint, lower: float, upper: float) -> str:
    """ "0° to 90°"."""
    return f"{value(joint, lower)} to {value(joint, upper)}"
