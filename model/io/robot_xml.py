"""XML files that describe robots, opened with care, and what a reader knows of its format.

Nothing else in a file passes in silence: the elements and attributes of URDF, and those of MJCF,
that are read or answered for. Attributes and whatever else stands in elements of MJCF that are
handed on are MuJoCo's to judge: it refuses what it doesn't know.
"""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from model.core.errors import InputFileError

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


_HEAD = 1 << 16
MAX_BYTES = 64 * 2**20
"""No honest URDF or MJCF is larger; its meshes lie beside it."""


def parse(path: Path, roots: tuple[str, ...] = (), kind: str = "this") -> Element:
    """The root element of a file without DTD and entities.

    Args:
        path: the file.
        roots: what the root may be called; anything where there are none.
        kind: such as ``a URDF``, for messages.

    Raises:
        InputFileError: where it can't be read, is too large, or is none of ``kind``.
    """
    from xml.etree.ElementTree import ParseError

    import defusedxml
    from defusedxml import ElementTree

    try:
        if path.stat().st_size > MAX_BYTES:
            raise InputFileError(path, f"is larger than 64 MiB, too large for {kind}")
        data = path.read_bytes()
    except OSError as error:
        raise InputFileError(path, error.strerror or "can't be read") from error
    try:
        root = ElementTree.fromstring(data.lstrip(), forbid_dtd=True)
    except defusedxml.DefusedXmlException as error:
        raise InputFileError(path, "declares a DTD or entities", "remove them") from error
    except (ParseError, ValueError, LookupError) as error:
        raise InputFileError(
            path, f"is not well-formed XML ({error})", f"{kind} is an XML file"
        ) from error
    if roots and root.tag not in roots:
        raise InputFileError(path, f"begins with <{root.tag}>", f"{kind} begins with <{roots[0]}>")
    return root


def begins(path: Path, suffixes: tuple[str, ...], how: re.Pattern[bytes]) -> bool:
    """True for a file with one of the suffixes that isn't hidden and begins as a pattern says."""
    if path.suffix.lower() not in suffixes or path.name.startswith(".") or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            return how.match(file.read(_HEAD)) is not None
    except OSError:
        return False


_LISTED = 5
"""Kinds that a remark names; it counts the others."""


def counted(found: Counter[str]) -> list[str]:
    """A remark that counts what isn't known; else nothing."""
    kinds = +found
    if not kinds:
        return []
    listed = ", ".join(f"{what} ({n})" for what, n in kinds.most_common(_LISTED))
    rest = f" and {len(kinds) - _LISTED} kinds more" if len(kinds) > _LISTED else ""
    return [f"ignored: {listed}{rest}"]


@dataclass(frozen=True)
class XmlSchema:
    """The elements and attributes that a reader reads or answers for.

    Attributes:
        elements: element → the elements and attributes that it may have; None where somebody else
            judges them. What stands in an element that has no entry isn't looked at.
        passed_over: elements that say nothing of shapes and motion, wherever they stand.
        repeated: elements of which several may stand in one; None for all.
        choices: elements that hold one of their elements.
    """

    elements: dict[str, tuple[frozenset[str] | None, frozenset[str] | None]]
    passed_over: frozenset[str]
    repeated: frozenset[str] | None
    choices: frozenset[str]

    @classmethod
    def of(
        cls,
        rows: tuple[tuple[str, str | None, str | None], ...],
        passed_over: str,
        repeated: str | None = None,
        choices: str = "",
    ) -> XmlSchema:
        """A schema from (element, its elements, its attributes), names with blanks between."""
        return cls(
            {tag: (_names(below), _names(said)) for tag, below, said in rows},
            frozenset(passed_over.split()),
            _names(repeated),
            frozenset(choices.split()),
        )

    def unread(self, root: Element) -> list[str]:
        """A remark that counts the elements and attributes that aren't known; else nothing."""
        found: Counter[str] = Counter()
        stack = [root]
        while stack:
            element = stack.pop()
            below, said = self.elements.get(element.tag, (None, None))
            if said is not None:
                found.update(
                    f"attribute {key!r} of <{element.tag}>"
                    for key in element.attrib
                    if key not in said and "}" not in key
                )
            seen = set[str]()
            for child in element:
                if not isinstance(child.tag, str) or child.tag in self.passed_over:
                    continue
                if below is not None and child.tag not in below:
                    found[f"<{child.tag}> in <{element.tag}>"] += 1
                elif seen and self._is_further(element.tag, child.tag, seen):
                    found[f"a further <{child.tag}> in <{element.tag}>"] += 1
                elif child.tag in self.elements:
                    stack.append(child)
                seen.add(child.tag)
        return counted(found)

    def _is_further(self, tag: str, child: str, seen: set[str]) -> bool:
        """True if a reader took another element in its place."""
        if tag in self.choices:
            return True
        return child in seen and self.repeated is not None and child not in self.repeated


def _names(text: str | None) -> frozenset[str] | None:
    return None if text is None else frozenset(text.split())


URDF = XmlSchema.of(
    (
        ("robot", "link joint material", "name version"),
        ("link", "inertial visual collision", "name type"),
        ("joint", "origin parent child axis limit mimic dynamics", "name type"),
        ("inertial", "origin mass inertia", ""),
        ("visual", "origin geometry material", "name"),
        ("collision", "origin geometry material", "name"),
        ("geometry", None, ""),  # the reader says which shapes it knows
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
    ),
    "gazebo transmission sensor ros2_control mujoco drake safety_controller calibration verbose "
    "contact_coefficients",
    repeated="link joint material visual collision",
    choices="geometry",
)


ROOTS = ("mujoco", "mujocoinclude")
KEPT = ("compiler", "default", "asset", "worldbody")
"""Sections that MuJoCo gets."""
WORLD = ("body", "joint", "freejoint", "geom", "inertial", "frame", "replicate")
DEFAULTS = ("default", "joint", "geom", "mesh", "material")
ASSETS = ("mesh", "texture", "material", "hfield")
LOST = {
    "actuator": "actuators",
    "tendon": "tendons",
    "composite": "composite bodies",
    "flexcomp": "soft bodies",
    "deformable": "soft bodies",
}
"""Elements that have a remark of their own."""
LOST_VALUES = {
    ("joint", "armature"): "armature of joints",
    ("geom", "friction"): "friction of surfaces",
    ("body", "gravcomp"): "compensation of gravity",
    ("body", "mocap"): "bodies moved by motion capture",
}
"""Attributes that have one."""
_WORLD = " ".join((*WORLD, *LOST))

MJCF = XmlSchema.of(
    (
        ("mujoco", " ".join((*KEPT, *LOST, "equality")), "model"),
        ("worldbody", _WORLD, ""),
        ("body", _WORLD, None),
        ("frame", _WORLD, "name childclass pos quat axisangle xyaxes zaxis euler"),
        ("replicate", _WORLD, "count sep offset euler"),
        ("default", " ".join(DEFAULTS), "class"),
        ("asset", " ".join(ASSETS), ""),
        ("compiler", "", None),
        ("joint", "", None),
        ("geom", "", None),
        ("inertial", "", None),
        ("mesh", "", None),
        ("texture", "", None),
        ("hfield", "", None),
        ("material", "layer", None),
    ),
    # Simulation, drawing, and defaults of what isn't read.
    "option size visual statistic custom sensor keyframe contact extension light camera site pair "
    "equality tendon general motor position velocity intvelocity damper cylinder muscle adhesion "
    "lengthrange",
)
