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
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import unescape

import numpy as np

from model.core.errors import InputFileError
from model.core.files import read_json
from model.io.formats.loaded import ReferenceRefused, read_bytes, resolve
from model.io.robot_xml import MAX_BYTES, parse

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element


URDF_SUFFIX = ".urdf"
MOBILITY = "mobility.urdf"
"""Name of an object's URDF in PartNet-Mobility."""
PACKAGE = "package.xml"
"""File that marks the folder of a ROS package."""
REPOSITORY = ".git"
BORDER = "artiworld-zip"
"""Empty file beside what a zip was unpacked to: no reference in there leaves this folder."""
_GIVEN, _MOST_GIVEN = "ARTIWORLD_FOLDERS", 100
PACKAGE_URI, MODEL_URI = "package://", "model://"
MODEL_CONFIG = "model.config"
"""File that marks the folder of a Gazebo model."""
_LEVELS = 4
_FILENAME = re.compile(
    r"""filename\s*=\s*["']([^"'<>]{1,1000})["']|<uri>\s*([^<>]{1,1000}?)\s*</uri>"""
)
"""In a URDF, and in an SDF."""


def is_urdf(path: Path) -> bool:
    """True if ``path`` has the suffix of a URDF and isn't hidden."""
    name = path.name
    return path.suffix.lower() == URDF_SUFFIX and not name.startswith(".") and path.is_file()


def allow(folder: Path) -> None:
    """Let models below a folder that a person gave name files anywhere in it.

    The environment holds the folders, where worker processes find them.
    """
    given = os.path.abspath(folder)
    known = [f for f in os.environ.get(_GIVEN, "").split("\n") if f and f != given]
    os.environ[_GIVEN] = "\n".join([*known, given][-_MOST_GIVEN:])


def package_root(path: Path, given: Path | None = None) -> Path:
    """The folder that the files of a model may not leave; its own, or a wider one above it.

    That is the nearest of the few above it that hold a ``package.xml``, the one of Gazebo's models,
    a repository's, one that a person gave (``given``, or :func:`allow`), whichever is widest; of a
    zip its own.
    """
    own = Path(os.path.abspath(path)).parent  # a repository left by `..` isn't above it
    above = (own, *own.parents)
    border = next((folder for folder in above if (folder / BORDER).is_file()), None)
    if border is not None:
        return border
    known = {os.path.abspath(given), *_given()} if given is not None else _given()
    package = [folder for folder in above[:_LEVELS] if (folder / PACKAGE).is_file()][:1]
    repository = [folder for folder in above if (folder / REPOSITORY).exists()][:1]
    models = above[1:2] if (own / MODEL_CONFIG).is_file() else ()
    wide = [*package, *models, *repository, *(folder for folder in above if str(folder) in known)]
    return min(wide, key=lambda folder: len(folder.parts), default=path.parent)


def _given() -> set[str]:
    return {*os.environ.get(_GIVEN, "").split("\n")} - {""}


def upwards(folder: Path, root: Path) -> list[Path]:
    """``folder`` and those above it up to ``root``."""
    folder, root = Path(os.path.abspath(folder)), Path(os.path.abspath(root))
    above = (folder, *folder.parents)
    return [f for f in above if f.is_relative_to(root)] or [folder, root]


def _in_package(whole: str, folder: Path, root: Path) -> list[tuple[Path, str]]:
    """Places of ``package/rest``, each as seen from a folder, the likeliest first: in the folder of
    the package, wherever that is, then in any."""
    name, _, rest = whole.partition("/")
    starts = upwards(folder, root)
    exact = [(start, rest) for start in starts if start.name == name]
    places = [*exact, *((s, whole) for s in starts), *((s, rest) for s in reversed(starts))]
    return [(start, text) for start, text in places if text]


def gazebo_model(folder: Path) -> Path | None:
    """The SDF in the folder of a Gazebo model, of several the one of the latest version."""
    try:
        config = parse(folder / MODEL_CONFIG, ("model",), "a model.config")
    except InputFileError:
        return None
    found: dict[tuple[int, ...], Path] = {}
    for entry in config.findall("sdf"):
        with suppress(ReferenceRefused, ValueError):
            file = resolve(entry.text or "", folder, folder)
            if file.is_file():
                version = tuple(int(n) for n in entry.get("version", "1").split("."))
                found.setdefault(version, folder / file.relative_to(folder.resolve()))
    return found[max(found)] if found else None


def _reference(text: str) -> str:
    """A reference with slashes; to a Gazebo model as to a ROS package."""
    text = text.strip().replace("\\", "/")
    return PACKAGE_URI + text.removeprefix(MODEL_URI) if text.startswith(MODEL_URI) else text


def named_meshes(path: Path) -> list[Path]:
    """Possible places of the meshes of a URDF or SDF, absolute, in its folder or package.

    Finds which files belong together; reads no XML and asks the disk for no mesh, so thousands take
    a moment. Empty where the file can't be read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            return []
        content = path.read_text("utf-8", "replace")
    except OSError:
        return []
    own, root = Path(os.path.abspath(path.parent)), Path(os.path.abspath(package_root(path)))
    found: dict[str, None] = {}
    for name in dict.fromkeys(a or b for a, b in _FILENAME.findall(content)):
        plain = _reference(unescape(name).removeprefix("file://"))
        places = [(own, plain)] if plain else []
        if plain.startswith(PACKAGE_URI):
            places = _in_package(plain.removeprefix(PACKAGE_URI), own, root)
        for start, text in places:
            target = os.path.normpath(start / text)
            if target.startswith(str(root) + os.sep):
                found[target] = None
    return list(map(Path, found))


def resolve_mesh(filename: str, folder: Path, root: Path) -> tuple[Path, bool]:
    """A mesh reference as a path inside ``root``, and whether only its end was found there.

    ``package://name/rest`` is looked for as ``rest`` and as ``name/rest`` in ``folder`` and those
    above it up to ``root``. A path of another machine, or of a folder that was moved, is looked for
    by its end.

    Raises:
        ReferenceRefused: for an empty or remote reference, and for an absolute one or one that
            leaves ``root`` of which no end is there.
    """
    text = _reference(filename)
    if not text.startswith(PACKAGE_URI):
        try:
            return resolve(text, folder, root), False
        except ReferenceRefused:
            found = None if "://" in text else _by_its_end(text, folder, root)
            if found is None:
                raise
            return found, True
    whole = text.removeprefix(PACKAGE_URI)
    if not whole:
        raise ReferenceRefused(f"{filename!r} is no file name")
    inside = [resolve(text, start, root) for start, text in _in_package(whole, folder, root)]
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
