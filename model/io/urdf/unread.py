"""Elements and attributes of a URDF file that aren't read."""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

_PASSED_OVER = (
    "gazebo", "transmission", "sensor", "ros2_control", "mujoco", "drake", "safety_controller",
    "calibration", "verbose", "contact_coefficients",
)  # fmt: skip
"""Elements that say nothing of shapes and motion."""
_KNOWN: dict[str, tuple[frozenset[str], frozenset[str]]] = {
    tag: (frozenset(children.split()), frozenset(attributes.split()))
    for tag, children, attributes in (
        ("robot", "link joint material", "name version"),
        ("link", "inertial visual collision", "name type"),
        ("joint", "origin parent child axis limit mimic dynamics", "name type"),
        ("inertial", "origin mass inertia", ""),
        ("visual", "origin geometry material", "name"),
        ("collision", "origin geometry material", "name"),
        ("geometry", "mesh box cylinder sphere capsule", ""),
        ("material", "color texture", "name"),
        ("origin", "", "xyz rpy quat_xyzw"),
        ("mass", "", "value"),
        ("inertia", "", "ixx ixy ixz iyy iyz izz"),
        ("mesh", "", "filename scale"),
        ("box", "", "size"),
        ("cylinder", "", "radius length"),
        ("sphere", "", "radius"),
        ("capsule", "", "radius length"),
        ("color", "", "rgba"),
        ("texture", "", "filename"),
        ("parent", "", "link"),
        ("child", "", "link"),
        ("axis", "", "xyz"),
        ("limit", "", "lower upper effort velocity acceleration deceleration jerk"),
        ("mimic", "", "joint multiplier offset"),
        ("dynamics", "", "damping friction"),
    )
}
"""Element → the elements and attributes that it may have; others are counted in a remark."""


def unread(robot: Element) -> list[str]:
    """A note that counts the elements and attributes that URDF hasn't; empty without any."""
    found: Counter[str] = Counter()
    stack = [robot]
    while stack:
        element = stack.pop()
        children, attributes = _KNOWN[element.tag]
        found.update(f"attribute {a!r} of <{element.tag}>" for a in element.attrib
                     if a not in attributes and "}" not in a)  # fmt: skip
        for child in element:
            if not isinstance(child.tag, str) or child.tag in _PASSED_OVER:
                continue
            if element.tag == "geometry" and child.tag not in children:
                continue  # an unknown shape has a message of its own
            if child.tag in children and child.tag in _KNOWN:
                stack.append(child)
            else:
                found[f"<{child.tag}> in <{element.tag}>"] += 1
    if not found:
        return []
    listed = ", ".join(f"{what} ({n})" for what, n in found.most_common(5))
    rest = f" and {len(found) - 5} kinds more" if len(found) > 5 else ""
    return [f"not read: {listed}{rest}"]
