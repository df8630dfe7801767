"""PartNet-Mobility folders (SAPIEN): ``mobility.urdf`` leads, names come from beside it.

The URDF wins over ``mobility_v2.json`` where the two disagree, because some were corrected by
hand. Links that are fixed to each other are one rigid part ("over-segmented annotations are
merged, and only parts that take part in articulation are kept", ArtiWorld, section on data).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.joint import JOINT_KINDS, Joint
from model.core.tree import KinematicTree
from model.data.protocol import GroundTruth
from model.io.formats.mtl import MaterialFiles
from model.io.merging import merge_rigid
from model.io.urdf.files import MOBILITY, partnet_category, read_json_beside, semantic_names
from model.io.urdf.meshes import load_part
from model.io.urdf.model import UrdfModel
from model.io.urdf.reader import read_urdf_model

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
        """See :class:`~model.data.protocol.Dataset`."""
        return partnet_category(Path(self.root) / object_id)

    def load(self, object_id: str) -> GroundTruth:
        """Read one object: see :func:`read_partnet_mobility`."""
        return read_partnet_mobility(Path(self.root) / object_id)


def read_partnet_mobility(folder: Path, *, shapes: bool = False) -> GroundTruth:
    """Read one PartNet-Mobility folder.

    Args:
        shapes: whether to load the collision shapes that it tells, too.

    Returns:
        The object in the URDF's root frame (+z up, metres as written), q = 0.

    Raises:
        InputFileError: where ``mobility.urdf`` or a mesh is missing or broken.
    """
    folder = Path(folder)
    model = read_urdf_model(folder / MOBILITY)
    names = semantic_names(folder)
    files = MaterialFiles(folder)  # textures lie in images/, beside the meshes' folder
    parts = {
        link: replace(load_part(link, visuals, files), name=None)
        for link, visuals in model.by_link.items()
    }
    if not parts:
        raise InputFileError(model.path, "no link has a mesh", "at least one is needed")
    obj, merged = merge_rigid(
        folder.name, model.tree, parts, names=names, category=partnet_category(folder),
        inertials=model.declared.inertials, collision=model.declared.collision if shapes else None,
    )  # fmt: skip
    notes = (*model.notes, *merged, *_disagreements(folder, model))
    return GroundTruth(folder.name, obj, notes)


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
