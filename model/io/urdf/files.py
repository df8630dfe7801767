"""Files of a URDF: where they may lie, and those that stand beside it or for it.

They lie in its folder, or in the ROS package around it. Files beside it name its parts and its
category.

Articulate AnyMesh writes ``mobility.json`` beside ``mesh_parts/`` instead of a URDF: a list of
``{id, parent, joint, name, jointData: {axis: {origin, direction}}}``, as its public code has it
(``ArticulateAnymesh/joint_estimation.py``): ``parent`` is a part's name, None of ``base``,
``joint`` a URDF's type. The frame is that of the meshes, ``mesh_parts/<name>.glb``. It tells no
limits, so a range has to be set before such a joint moves.
"""

from __future__ import annotations

import json
import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import unescape

import numpy as np

from model.core.errors import InputFileError
from model.core.files import read_json
from model.io.formats.loaded import ReferenceRefused, read_bytes, resolve
from model.io.robot_xml import MAX_BYTES

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


URDF_SUFFIX = ".urdf"
MOBILITY = "mobility.urdf"
"""Name of an object's URDF in PartNet-Mobility."""
PACKAGE = "package.xml"
"""File that marks the folder of a ROS package."""
PACKAGE_URI, MODEL_URI = "package://", "model://"
_LEVELS = 4
_FILENAME = re.compile(
    r"""filename\s*=\s*["']([^"'<>]{1,1000})["']|<uri>\s*([^<>]{1,1000}?)\s*</uri>"""
)
"""In a URDF, and in an SDF."""


def is_urdf(path: Path) -> bool:
    """True if ``path`` has the suffix of a URDF and isn't hidden."""
    name = path.name
    return path.suffix.lower() == URDF_SUFFIX and not name.startswith(".") and path.is_file()


def package_root(path: Path) -> Path:
    """The folder of the ROS package that a URDF belongs to, else the URDF's own folder.

    It is the nearest of the URDF's folder and the few above it that holds a ``package.xml``.
    """
    own = path.absolute().parent
    above = (own, *own.parents)[:_LEVELS]
    return next((folder for folder in above if (folder / PACKAGE).is_file()), path.parent)


def named_meshes(path: Path) -> list[Path]:
    """Possible places of the meshes of a URDF or SDF, absolute, in its folder or package.

    Finds which files belong together; reads no XML and asks the disk for no mesh, so thousands take
    a moment. Empty where the file can't be read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            return []
        text = path.read_text("utf-8", "replace")
    except OSError:
        return []
    own, root = os.path.abspath(path.parent), os.path.abspath(package_root(path))
    found: dict[str, None] = {}
    for name in dict.fromkeys(a or b for a, b in _FILENAME.findall(text)):
        plain = unescape(name).strip().replace("\\", "/").removeprefix("file://")
        if plain.startswith(MODEL_URI):
            plain = PACKAGE_URI + plain.removeprefix(MODEL_URI)
        places = [(own, plain)]
        if plain.startswith(PACKAGE_URI):
            whole = plain.removeprefix(PACKAGE_URI)
            places = [(at, t) for at in (root, own) for t in (whole.partition("/")[2], whole)]
        for at, rest in places:
            target = os.path.normpath(os.path.join(at, rest))
            if rest and target.startswith(root + os.sep):
                found[target] = None
    return list(map(Path, found))


def resolve_mesh(filename: str, folder: Path, root: Path) -> tuple[Path, bool]:
    """A mesh reference as a path inside ``root``, and whether only its end was found there.

    ``package://name/rest`` is looked for as ``rest`` and as ``name/rest`` in ``root``, then in
    ``folder``. A path of another machine, or of a folder that was moved, is looked for by its end.

    Raises:
        ReferenceRefused: for an empty or remote reference, and for an absolute one or one that
            leaves ``root`` of which no end is there.
    """
    text = filename.strip().replace("\\", "/")
    if not text.startswith(PACKAGE_URI):
        try:
            return resolve(text, folder, root), False
        except ReferenceRefused:
            found = None if "://" in text else _by_its_end(text, folder, root)
            if found is None:
                raise
            return found, True
    whole = text.removeprefix(PACKAGE_URI)
    texts = [text for text in (whole.partition("/")[2], whole) if text]
    inside = [resolve(text, start, root) for start in (root, folder) for text in texts]
    if not inside:
        raise ReferenceRefused(f"{filename!r} is no file name")
    there = next((p for p in inside if p.exists()), None)
    found = there or _by_its_end(whole, folder, root)
    return found or inside[0], there is None and found is not None


def _by_its_end(text: str, folder: Path, root: Path) -> Path | None:
    """The file inside ``root`` at the longest end of a path, seen from ``folder`` or ``root``."""
    words = [word for word in text.split("/") if word not in ("", ".", "..")]
    for first in range(len(words)):
        for start in (folder, root):
            try:
                found = resolve("/".join(words[first:]), start, root)
            except ReferenceRefused:
                continue
            if found.is_file():
                return found
    return None


DESCRIPTION = "object.json"


def description_beside(path: Path) -> dict[str, Any]:
    """The content of the ``object.json`` beside a URDF; empty without one.

    Raises:
        InputFileError: where it can't be read.
    """
    said = read_json_beside(path.parent / DESCRIPTION)
    return said if isinstance(said, dict) else {}


def partnet_category(folder: Path) -> str | None:
    """The category in ``meta.json``."""
    meta = read_json_beside(folder / "meta.json")
    category = meta.get("model_cat") if isinstance(meta, dict) else None
    return category if isinstance(category, str) else None


def semantic_names(folder: Path) -> dict[str, str]:
    """``link_k`` → part name, from semantics.txt, else from mobility_v2.json."""
    path = folder / "semantics.txt"
    if path.exists():
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return {r[0]: r[2] for r in rows if len(r) >= 3}
    nodes = read_json_beside(folder / "mobility_v2.json")
    if not isinstance(nodes, list):
        return {}
    return {f"link_{n['id']}": str(n["name"]) for n in nodes if "id" in n and n.get("name")}


def read_json_beside(path: Path) -> object:
    """The JSON value in a file; an empty object where the file is absent.

    Raises:
        InputFileError: where it is not JSON.
    """
    return read_json(path) if path.exists() else {}


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
            path,
            f"is no list of parts with name and jointData ({error!r})",
            "give what Articulate AnyMesh wrote",
        ) from None
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
