"""What the gate's sentences call parts, lengths and joint values."""

from __future__ import annotations

from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint, value_text

BASE = "base"


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


def title(obj: ArticulatedObject, link: str) -> str:
    """A link in people's words; see :func:`called`."""
    name = next((p.name for p in obj.parts if p.link == link), None)
    return called(link, name, root=link == obj.tree.root)


def length(metres: float) -> str:
    """Millimetres, with a decimal where they are few."""
    return f"{1000 * metres:.1f} mm" if metres < 0.01 else f"{1000 * metres:.0f} mm"


def value(joint: Joint, q: float) -> str:
    """Degrees or millimetres."""
    return value_text(q, joint.rotates)


def interval(joint: Joint, lower: float, upper: float) -> str:
    """ "0° to 90°"."""
    return f"{value(joint, lower)} to {value(joint, upper)}"
