"""Output of Articulate AnyMesh instead of a URDF: ``mobility.json`` beside ``mesh_parts/``.

A list of ``{id, parent, joint, name, jointData: {axis: {origin, direction}}}``, as its public code
has it (``ArticulateAnymesh/joint_estimation.py``): ``parent`` is a part's name, None of ``base``,
``joint`` a URDF's type. The frame is that of the meshes, ``mesh_parts/<name>.glb``. It tells no
limits, so a range has to be set before such a joint moves.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from model.core.errors import InputFileError
from model.io.formats.loaded import read_bytes

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

ANYMESH = "mobility.json"
MESHES = "mesh_parts"
_MOST_BYTES = 16 * 2**20


def is_anymesh(path: Path) -> bool:
    """True if ``path`` is such a file, by its name and the meshes beside it."""
    return path.name == ANYMESH and path.is_file() and (path.parent / MESHES).is_dir()


def robot_of(path: Path) -> Element:
    """The same as a URDF's ``<robot>``.

    Raises:
        InputFileError: where it is no such list; what a URDF's reader checks is left to it.
    """
    from xml.etree import ElementTree as ET  # makes elements; nothing is parsed

    try:
        entries: Any = json.loads(read_bytes(path, _MOST_BYTES))
        axes = {str(e["name"]): (e.get("jointData") or {}).get("axis") or {} for e in entries}
        origins = {n: np.array(a.get("origin") or (0, 0, 0), float) for n, a in axes.items()}
        ways = {n: " ".join(map(str, a["direction"])) for n, a in axes.items() if "direction" in a}
        if any(o.shape != (3,) for o in origins.values()) or len(axes) < len(entries):
            raise ValueError("each part needs a name of its own, an origin three numbers")
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise InputFileError(
            path, f"is no list of parts with name and jointData ({error!r})",
            "give what Articulate AnyMesh wrote",
        ) from None  # fmt: skip
    robot = ET.Element("robot", name=path.absolute().parent.name)
    for name, entry in zip(axes, entries, strict=True):
        visual = ET.SubElement(ET.SubElement(robot, "link", name=name), "visual")
        ET.SubElement(visual, "origin", xyz=_text(-origins[name]))
        shape = ET.SubElement(visual, "geometry")
        ET.SubElement(shape, "mesh", filename=f"{MESHES}/{name}.glb")
        parent = entry.get("parent")
        if parent is None:
            continue
        joint = ET.SubElement(robot, "joint", name=f"joint {name}", type=str(entry.get("joint")))
        ET.SubElement(joint, "parent", link=str(parent))
        ET.SubElement(joint, "child", link=name)
        above = origins.get(str(parent), np.zeros(3))
        ET.SubElement(joint, "origin", xyz=_text(origins[name] - above))
        if name in ways:
            ET.SubElement(joint, "axis", xyz=ways[name])
        ET.SubElement(joint, "limit", effort="100", velocity="1")
    return robot


def _text(values: np.ndarray) -> str:
    return " ".join(f"{v:.17g}" for v in values.tolist())
