"""A URDF or MJCF as read, before its meshes are loaded; and where a URDF's files may lie."""

from __future__ import annotations

import os
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from xml.sax.saxutils import unescape

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Part
from model.core.mesh import Material, Mesh
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.io.formats.references import ReferenceRefused, resolve
from model.io.urdf.declared_physics import Told
from model.io.xml_file import MAX_BYTES


@dataclass(frozen=True, eq=False)
class UrdfVisual:
    """One piece of a link's geometry.

    Attributes:
        link: the link that carries it.
        name: the element's ``name``, or None.
        object_from_geometry: (4, 4) from the file's coordinates to the object frame at rest,
            scale included.
        file: the mesh file, resolved; None for a primitive, and for ``mesh``.
        primitive: ``("box", (x, y, z))``, ``("cylinder", (radius, length))``, ``("sphere",
            (radius,))`` or ``("capsule", (radius, length without the caps))`` in metres; None for
            a file.
        color: RGBA in 0..255 from the URDF's material, or None. It is for what has no looks.
        mesh: geometry that no file holds, or None.
        material: takes the place of what a mesh file says of its looks, or None.
    """

    link: str
    name: str | None
    object_from_geometry: npt.NDArray[np.float64]
    file: Path | None = None
    primitive: tuple[str, tuple[float, ...]] | None = None
    color: tuple[int, int, int, int] | None = None
    mesh: Mesh | None = None
    material: Material | None = None


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """A URDF, or another file that tells the same, without its meshes loaded.

    Attributes:
        tree: joints in the object's rest frame, which is the root link's frame.
        visuals: geometry in the file's order.
        notes: what was changed on reading, for people.
        rescaled: those of the notes that tell of an axis whose length wasn't 1: it means the same.
        renamed: those that tell of a link that became a helper by name alone.
        faulty: joints that couldn't be read and stand as fixed ones; only of a lenient reading.
        swapped: joints whose lower limit was written above the upper one; here they are in order.
        told: masses, joint dynamics and collision shapes; :meth:`load` leaves them out.
        files: that were read beside the file itself and the meshes.
        part_names: link → what the file says it is, in people's words.
    """

    path: Path
    name: str
    tree: KinematicTree
    visuals: tuple[UrdfVisual, ...]
    notes: tuple[str, ...] = ()
    faulty: tuple[str, ...] = ()
    swapped: tuple[str, ...] = ()
    rescaled: tuple[str, ...] = ()
    renamed: tuple[str, ...] = ()
    told: Told = field(default_factory=Told)
    files: tuple[Path, ...] = ()
    part_names: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def by_link(self) -> Mapping[str, tuple[UrdfVisual, ...]]:
        """Link → its visuals; links without any are left out."""
        out: dict[str, tuple[UrdfVisual, ...]] = {}
        for visual in self.visuals:
            out[visual.link] = (*out.get(visual.link, ()), visual)
        return out

    def load(self, progress: Progress = no_progress) -> ArticulatedObject:
        """Read the meshes. Links without geometry become helpers.

        Raises:
            InputFileError: for a mesh file that can't be read.
        """
        from model.io.urdf.meshes import load_part

        parts: list[Part] = []
        for i, (link, visuals) in enumerate(self.by_link.items()):
            progress(i / len(self.by_link), f"reading {link}")
            part = load_part(link, visuals)
            parts.append(replace(part, name=self.part_names.get(link, part.name)))
        progress(1.0, "read")
        return ArticulatedObject(self.name, tuple(parts), self.tree)


URDF_SUFFIX = ".urdf"
MOBILITY = "mobility.urdf"
"""What PartNet-Mobility calls an object's."""
PACKAGE = "package.xml"
"""What marks the folder of a ROS package."""
_PACKAGE_URI = "package://"
_LEVELS = 4
_FILENAME = re.compile(r"""filename\s*=\s*["']([^"'<>]{1,1000})["']""")


def is_urdf(path: Path) -> bool:
    """Whether ``path`` is a file that is called a URDF, and none of a system's hidden ones."""
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
    """Where the meshes of a URDF may lie, absolute and inside its folder or package.

    For telling what belongs together: neither is it read as XML, nor is the disk asked, so that
    thousands are looked at in a moment. None where it can't be read.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            return []
        text = path.read_text("utf-8", "replace")
    except OSError:
        return []
    own, root = os.path.abspath(path.parent), os.path.abspath(package_root(path))
    found: dict[str, None] = {}
    for name in dict.fromkeys(_FILENAME.findall(text)):
        plain = unescape(name).strip().replace("\\", "/")
        places = [(own, plain)]
        if plain.startswith(_PACKAGE_URI):
            whole = plain.removeprefix(_PACKAGE_URI)
            places = [(at, t) for at in (root, own) for t in (whole.partition("/")[2], whole)]
        for at, rest in places:
            target = os.path.normpath(os.path.join(at, rest))
            if rest and target.startswith(root + os.sep):
                found[target] = None
    return list(map(Path, found))


def resolve_mesh(filename: str, folder: Path, root: Path) -> Path:
    """A mesh reference as a path inside ``root``.

    ``package://name/rest`` is looked for as ``rest`` and as ``name/rest`` in ``root``, then in
    ``folder``.

    Raises:
        ReferenceRefused: for an empty, absolute or remote reference, or one that leaves ``root``.
    """
    text = filename.strip().replace("\\", "/")
    if not text.startswith(_PACKAGE_URI):
        return resolve(text, folder, root)
    whole = text.removeprefix(_PACKAGE_URI)
    texts = [text for text in (whole.partition("/")[2], whole) if text]
    inside = [resolve(text, start, root) for start in (root, folder) for text in texts]
    if not inside:
        raise ReferenceRefused(f"{filename!r} is no file name")
    return next((p for p in inside if p.exists()), inside[0])


def renamed_helpers(
    links: Sequence[str], owning: Collection[str], notes: list[str]
) -> dict[str, str]:
    """New names of links without geometry whose own begin with ``link_``, as parts' do.

    Args:
        links: all of the file.
        owning: those with geometry.
        notes: told of each, for people.
    """
    out: dict[str, str] = {}
    for link in links:
        if link.startswith("link_") and link not in owning:
            base = new = "helper_" + link.removeprefix("link_").removesuffix("_helper")
            i = 2
            while new in links or new in out.values():
                new, i = f"{base}_{i}", i + 1
            out[link] = new
            notes.append(f"link {link!r} has no geometry; it became the helper {new!r}")
    return out
