"""A URDF, MJCF or USD as read, before its meshes are loaded."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

from model.core.articulated_object import ArticulatedObject, Part
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.io.urdf.declared_physics import DeclaredPhysics
from model.io.urdf.meshes import load_part
from model.io.urdf.visual import UrdfVisual


@dataclass(frozen=True, eq=False)
class UrdfModel:
    """A URDF, or another file that tells the same, without its meshes loaded.

    Attributes:
        tree: joints in the object's rest frame, which is the root link's frame.
        visuals: geometry in the file's order.
        notes: human-readable remarks on changes made on reading.
        rescaled: those of the notes about an axis whose length wasn't 1: it means the same.
        renamed: those about a link that became a helper by name alone.
        faulty: joints that couldn't be read and stand as fixed ones; only of a lenient reading.
        swapped: joints whose lower limit was written above the upper one; here they are in order.
        declared: masses, joint dynamics and collision shapes; :meth:`load` leaves them out.
        files: that were read beside the file itself and the meshes.
        part_names: link → display name that the file declares.
        category: what the file says of the whole, or None.
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
    declared: DeclaredPhysics = field(default_factory=DeclaredPhysics)
    files: tuple[Path, ...] = ()
    part_names: Mapping[str, str] = field(default_factory=dict)
    category: str | None = None

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
        parts: list[Part] = []
        for i, (link, visuals) in enumerate(self.by_link.items()):
            progress(i / len(self.by_link), f"reading {link}")
            part = load_part(link, visuals)
            parts.append(replace(part, name=self.part_names.get(link, part.name)))
        progress(1.0, "read")
        return ArticulatedObject(self.name, tuple(parts), self.tree, self.category)


def renamed_helpers(
    links: Sequence[str], owning: Collection[str], notes: list[str]
) -> dict[str, str]:
    """New names of links without geometry whose own begin with ``link_``, as parts' do.

    Args:
        links: all of the file.
        owning: those with geometry.
        notes: gets a human-readable remark on each.
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
