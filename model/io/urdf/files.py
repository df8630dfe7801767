"""Possible places of a URDF's files: its folder, or the ROS package around it."""

from __future__ import annotations

import os
import re
from pathlib import Path
from xml.sax.saxutils import unescape

from model.io.formats.references import ReferenceRefused, resolve
from model.io.xml_file import MAX_BYTES

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
