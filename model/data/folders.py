"""Folders as data sets: PartNet-Mobility, other URDFs, MJCF files, the bundled examples.

In PartNet-Mobility folders (SAPIEN) ``mobility.urdf`` leads, names come from beside it. The URDF
wins over ``mobility_v2.json`` where the two disagree, because some were corrected by hand. Links
that are fixed to each other are one rigid part ("over-segmented annotations are merged, and only
parts that take part in articulation are kept", ArtiWorld, section on data). MJCF files are read as
the app opens them. Any object can be written as the folder of part meshes that a predictor reads.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import InputFileError
from model.core.files import read_json, static_assets
from model.core.joint import JOINT_KINDS, Joint
from model.core.tree import KinematicTree
from model.data.registry import GroundTruth
from model.geometry.splitting import split
from model.io.merging import merge_rigid, read_rigid
from model.io.mjcf_reader import need_mujoco, read_mjcf_model
from model.io.open_asset import open_asset
from model.io.urdf.files import (
    ANYMESH,
    MOBILITY,
    description_beside,
    is_anymesh,
    partnet_category,
    read_json_beside,
)
from model.io.urdf.meshes import load_part
from model.io.urdf.model import UrdfModel
from model.io.write import write_cloud, write_mesh

_TURNS = frozenset(kind for kind, row in JOINT_KINDS.items() if row.rotates)
_SLIDES = frozenset(kind for kind, row in JOINT_KINDS.items() if row.slides)
_STAYS = frozenset({"fixed"})
_SAID = {
    "hinge": _TURNS,
    "slider": _SLIDES,
    "heavy": _STAYS,
    "free": _STAYS,
    "static": _STAYS,
    "junk": _STAYS,
}
"""Words of ``mobility_v2.json`` → joint types that fit them."""


@dataclass(frozen=True)
class PartNetMobility:
    """A folder of PartNet-Mobility objects, one sub-folder each."""

    root: Path
    name: str = "partnet-mobility"

    def ids(self) -> tuple[str, ...]:
        """Sub-folders with a ``mobility.urdf``, sorted.

        Raises:
            InputFileError: where there is none.
        """
        found = tuple(sorted(p.parent.name for p in Path(self.root).glob("*/mobility.urdf")))
        if not found:
            raise InputFileError(
                self.root,
                "no PartNet-Mobility object in it",
                "give the folder that holds <id>/mobility.urdf",
            )
        return found

    def category(self, object_id: str) -> str | None:
        """See :class:`~model.data.registry.Dataset`."""
        return partnet_category(Path(self.root) / object_id)

    def load(self, object_id: str) -> GroundTruth:
        """Read one object: see :func:`read_partnet_mobility`."""
        return read_partnet_mobility(Path(self.root) / object_id)


def read_partnet_mobility(folder: Path) -> GroundTruth:
    """Read one PartNet-Mobility folder; see :func:`~model.io.merging.read_rigid`.

    Raises:
        InputFileError: where ``mobility.urdf``, or all meshes, are missing or broken.
    """
    obj, model, notes = read_rigid(folder / MOBILITY, folder.name)
    return GroundTruth(folder.name, obj, (*notes, *_disagreements(folder, model)))


def _disagreements(folder: Path, model: UrdfModel) -> tuple[str, ...]:
    """Differences of ``mobility_v2.json`` from the URDF, which takes precedence."""
    nodes = read_json_beside(folder / "mobility_v2.json")
    out: list[str] = []
    for node in nodes if isinstance(nodes, list) else ():
        link, said = f"link_{node.get('id')}", node.get("joint")
        chain = _chain(model.tree, link)
        if not chain or said not in _SAID:
            continue
        fitting = [j for j in chain if j.type in _SAID[said]]
        if not fitting:
            shown = ", ".join(sorted({j.type for j in chain} - {"fixed"})) or "fixed"
            out.append(f"{link}: mobility_v2.json says {said}, the URDF {shown}; the URDF counts")
        elif fitting[0].limited and not _same_range(fitting[0], node):
            out.append(f"{link}: mobility_v2.json has another range; the URDF's counts")
    return tuple(out)


def _chain(tree: KinematicTree, link: str) -> list[Joint]:
    """The joints between ``link`` and the next link that is one of the file's parts."""
    out: list[Joint] = []
    joint = tree.joint_of.get(link)
    while joint is not None:
        out.append(joint)
        joint = None if joint.parent.startswith("link_") else tree.joint_of.get(joint.parent)
    return out


def _same_range(joint: Joint, node: Mapping[str, Any]) -> bool:
    """True if the node's limits are the joint's, up to the axis' sign and whole turns."""
    limit = (node.get("jointData") or {}).get("limit")
    if not limit:
        return True
    if limit.get("noLimit"):
        return False
    assert joint.lower is not None and joint.upper is not None
    scale = math.pi / 180 if joint.rotates else 1.0
    low, high = sorted((limit["a"] * scale, limit["b"] * scale))
    tolerance = 0.02 * max(1.0 if joint.rotates else 0.1, high - low)
    turns = (-2, -1, 0, 1, 2) if joint.rotates else (0,)
    return any(
        abs(joint.lower - a - 2 * math.pi * k) <= tolerance
        and abs(joint.upper - b - 2 * math.pi * k) <= tolerance
        for a, b in ((low, high), (-high, -low))
        for k in turns
    )


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
        """See :class:`~model.data.registry.Dataset`."""
        said = description_beside(self._path(object_id)).get("category")
        return said if isinstance(said, str) else None

    def load(self, object_id: str) -> GroundTruth:
        """Read one object, its rigid groups merged.

        Raises:
            InputFileError: where the URDF or a mesh is broken, or all are missing.
        """
        obj, _, notes = read_rigid(self._path(object_id), object_id, root=self.root)
        return GroundTruth(object_id, obj, notes)

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


@dataclass(frozen=True)
class MjcfFolder:
    """``<id>.xml`` or ``<id>/*.xml`` that MuJoCo can load."""

    root: Path
    name: str = "mjcf"

    def ids(self) -> tuple[str, ...]:
        """Names of files and sub-folders, sorted; files that others include are among them.

        Raises:
            InputFileError: where there is none.
            ConfigurationError: where MuJoCo isn't installed.
        """
        need_mujoco()
        found = self._files()
        if not found:
            raise InputFileError(
                self.root, "no MJCF in it", "give a folder of <id>.xml or <id>/<any>.xml"
            )
        return tuple(sorted(found))

    def _files(self) -> dict[str, Path]:
        root = Path(self.root)
        out = {p.stem: p for p in sorted(root.glob("*.xml"))}
        for folder in sorted(p for p in root.iterdir() if p.is_dir()) if root.is_dir() else ():
            here = sorted(folder.glob("*.xml"))
            if here and folder.name not in out:
                named = [p for p in here if p.stem in (folder.name, "object")]
                out[folder.name] = (named or here)[0]
        return out

    def category(self, object_id: str) -> str | None:
        """MJCF doesn't say."""
        return None

    def load(self, object_id: str) -> GroundTruth:
        """Read one object.

        Raises:
            InputFileError: where MuJoCo can't load it, or nothing in it can be seen.
        """
        path = self._files().get(object_id)
        if path is None:
            raise InputFileError(Path(self.root) / object_id, "no MJCF there")
        model = read_mjcf_model(path, root=self.root)
        parts = {link: load_part(link, visuals) for link, visuals in model.by_link.items()}
        obj, merges = merge_rigid(object_id, model.tree, parts)
        return GroundTruth(object_id, obj, (*model.notes, *merges))


class Bundled:
    """``<id>.glb`` or ``<id>.ply`` with ``truth/<id>.json``.

    Args:
        root: folder; by default the examples that ArtiWorld brings along.
    """

    name = "bundled"

    def __init__(self, root: Path | None = None) -> None:
        self._folder = root or static_assets() / "examples"

    def ids(self) -> tuple[str, ...]:
        """Names, sorted.

        Raises:
            InputFileError: where there is none.
        """
        found = tuple(sorted(p.stem for p in (self._folder / "truth").glob("*.json")))
        if not found:
            raise InputFileError(self._folder, "no truth/<id>.json in it", "leave --root out")
        return found

    def category(self, object_id: str) -> str | None:
        """Category of the example."""
        return self._truth(object_id)["category"]

    def _truth(self, object_id: str) -> dict[str, Any]:
        if object_id not in self.ids():
            raise InputFileError(
                self._folder, f"no example {object_id!r}", f"there are {', '.join(self.ids())}"
            )
        return read_json(self._folder / "truth" / f"{object_id}.json")

    def load(self, object_id: str) -> GroundTruth:
        """Open the scan or mesh and cut it."""
        truth = self._truth(object_id)
        (file,) = (p for p in self._folder.glob(f"{object_id}.*") if p.suffix in (".glb", ".ply"))
        parts_of, counts = zip(*truth["runs"], strict=True)
        labels = np.maximum(np.repeat(parts_of, counts), 0)
        names = {p["id"]: p["name"] for p in truth["parts"]}
        joints = tuple(
            Joint(**{**j, "axis": tuple(j["axis"]), "origin": tuple(j["origin"])})
            for j in truth["joints"]
        )
        tree = KinematicTree(tuple(truth["links"]), joints)
        parts = split(open_asset(file), labels, names)
        return GroundTruth(object_id, ArticulatedObject(object_id, parts, tree, truth["category"]))


def export_parts(
    truth: GroundTruth,
    folder: Path,
    *,
    with_names: bool = True,
    rng: np.random.Generator | None = None,
) -> Path:
    """Write the parts of ``truth`` at rest, without their tree.

    One ``link_*.obj`` (a cloud: ``.ply``) a part and ``object.json``, which is
    ``{"category": ..., "parts": [{"file": ..., "name": ...}]}``.

    Args:
        truth: the object.
        folder: made where it isn't there.
        with_names: whether category and part names are written.
        rng: lists the parts in a random order; in their natural one where it is None.

    Returns:
        The path of ``object.json``.
    """
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    entries = []
    for part in truth.segmented(names=with_names).parts:
        if part.mesh is not None:
            path = folder / f"{part.link}.obj"
            write_mesh(part.mesh, path)
        else:
            assert part.cloud is not None
            path = folder / f"{part.link}.ply"
            write_cloud(part.cloud, path)
        entry = {"file": path.name}
        if part.name:
            entry["name"] = part.name
        entries.append(entry)
    if rng is not None:
        entries = [entries[i] for i in rng.permutation(len(entries))]
    document: dict[str, object] = {"parts": entries}
    if with_names and truth.object.category:
        document = {"category": truth.object.category, **document}
    out = folder / "object.json"
    out.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return out
