"""What the gate's sentences call parts, lengths and joint values."""

from __future__ import annotations

from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint, value_text


def title(obj: ArticulatedObject, link: str) -> str:
    """A link in people's words: "door 2"; else its own name, of the root "base"."""
    name = next((p.name for p in obj.parts if p.link == link), None)
    digits = link.removeprefix("link_")
    if not name or name == link or not digits.isdigit():
        return "base" if link == obj.tree.root and name in (None, "", link) else link
    return f"{name} {digits}"


def length(metres: float) -> str:
    """Millimetres, with a decimal where they are few."""
    return f"{1000 * metres:.1f} mm" if metres < 0.01 else f"{1000 * metres:.0f} mm"


def value(joint: Joint, q: float) -> str:
    """Degrees or millimetres."""
    return value_text(q, joint.rotates)


def interval(joint: Joint, lower: float, upper: float) -> str:
    """ "0° to 90°"."""
    return f"{value(joint, lower)} to {value(joint, upper)}"
