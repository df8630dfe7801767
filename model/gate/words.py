"""What the gate's sentences call parts, lengths and joint values."""

from __future__ import annotations

import math

from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint


def title(obj: ArticulatedObject, link: str) -> str:
    """A link in people's words: "door 2", else its own name."""
    name = next((p.name for p in obj.parts if p.link == link), None)
    digits = link.removeprefix("link_")
    if not name or name == link or not digits.isdigit():
        return link
    return f"{name} {digits}"


def length(metres: float) -> str:
    """Millimetres, with a decimal where they are few."""
    return f"{1000 * metres:.1f} mm" if metres < 0.01 else f"{1000 * metres:.0f} mm"


def value(joint: Joint, q: float) -> str:
    """Degrees or millimetres."""
    shown = math.degrees(q) if joint.rotates else 1000 * q
    text = f"{shown:.0f}" if abs(shown) >= 10 or shown == round(shown) else f"{shown:.1f}"
    text = "0" if text in ("-0", "-0.0", "0.0") else text
    return f"{text}°" if joint.rotates else f"{text} mm"


def interval(joint: Joint, lower: float, upper: float) -> str:
    """ "0° to 90°"."""
    return f"{value(joint, lower)} to {value(joint, upper)}"
