"""Any folder of URDFs with their meshes as a data set."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from model.core.errors import InputFileError
from model.data.protocol import GroundTruth
from model.io.formats.mtl import MaterialFiles
from model.io.merging import merge_rigid
from model.io.urdf.files import ANYMESH, description_beside, is_anymesh
from model.io.urdf.meshes import load_part
from model.io.urdf.reader import read_urdf_model

PREFERRED = ("object.urdf", "mobility.urdf")
"""Preferred files of a folder with several URDFs, after the one with the folder's own name."""


@dataclass(frozen=True)
class UrdfFolders:
    """URDFs below one folder: ``<id>.urdf`` or ``<id>/*.urdf``.

    An ``object.json`` beside a URDF may say ``{"category": "cabinet", "names": {"link_1":
    "door"}}``. The files' frame is taken as it is: +z up, metres, as URDF has it.
    """

    root: Path
    name: str = "urdf"

    def ids(self) -> tuple[str, ...]:
        """Names of files and sub-folders, sorted.

        Raises:
            InputFileError: where there is none.
        """
        found = urdf_files(self.root)
        if not found:
            raise InputFileError(
                self.root, "no URDF in it", "give a folder of <id>.urdf or <id>/<any>.urdf"
            )
        return tuple(sorted(found))

    def category(self, object_id: str) -> str | None:
        """See :class:`~model.data.protocol.Dataset`."""
        said = description_beside(self._path(object_id)).get("category")
        return said if isinstance(said, str) else None

    def load(self, object_id: str, *, shapes: bool = False) -> GroundTruth:
        """Read one object, its rigid groups merged.

        Args:
            shapes: whether to load the collision shapes that it tells, too.

        Raises:
            InputFileError: where the URDF or a mesh is missing or broken.
        """
        path = self._path(object_id)
        model = read_urdf_model(path, root=self.root)
        # Part names come from object.json alone; names of visuals are the file's own.
        files = MaterialFiles(path.parent)
        parts = {
            link: replace(load_part(link, visuals, files), name=None)
            for link, visuals in model.by_link.items()
        }
        if not parts:
            raise InputFileError(path, "no link has a mesh", "at least one is needed")
        names = description_beside(path).get("names")
        named = {
            link: str(name)
            for link, name in (names if isinstance(names, dict) else {}).items()
            if link in parts
        }
        category = self.category(object_id)
        obj, notes = merge_rigid(
            object_id, model.tree, parts, names=named, category=category,
            inertials=model.declared.inertials,
            collision=model.declared.collision if shapes else None,
        )  # fmt: skip
        return GroundTruth(object_id, obj, (*model.notes, *notes))

    def _path(self, object_id: str) -> Path:
        found = urdf_files(self.root).get(object_id)
        if found is None:
            raise InputFileError(
                Path(self.root) / object_id, "no URDF there", f"give one of {', '.join(self.ids())}"
            )
        return found


def urdf_files(root: Path) -> dict[str, Path]:
    """Object id → its URDF: ``<id>.urdf``, else the one URDF in the sub-folder ``<id>``.

    Where a sub-folder has several, the one called after it stands for it, else one of
    :data:`PREFERRED`; with none of these each is an object, ``<folder>.<file>``. A sub-folder
    without any is searched one level deeper; of URDFs with one name there the last counts: a later
    run, ``pred`` and not ``gt``. Articulate AnyMesh's ``mobility.json`` stands for a URDF.
    """
    root = Path(root)
    out = {p.stem: p for p in sorted(root.glob("*.urdf"))}
    for folder in sorted(p for p in root.iterdir() if p.is_dir()) if root.is_dir() else ():
        here = {p.name: p for p in sorted(folder.glob("*.urdf")) or sorted(folder.glob("*/*.urdf"))}
        if not here and is_anymesh(folder / ANYMESH):
            here = {ANYMESH: folder / ANYMESH}
        order = [n for n in (f"{folder.name}.urdf", *PREFERRED) if n in here]
        if order or len(here) == 1:
            out.setdefault(folder.name, here[order[0]] if order else next(iter(here.values())))
        else:
            out.update({f"{folder.name}.{p.stem}": p for p in here.values()})
    return out
