"""PartNet-Mobility folders (SAPIEN): ``mobility.urdf`` leads, names come from beside it.

The URDF wins over ``mobility_v2.json`` where the two disagree, because some were corrected by
hand. Links that are fixed to each other are one rigid part ("over-segmented annotations are
merged, and only parts that take part in articulation are kept", ArtiWorld, section on data).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from model.datasets.protocol import GroundTruth
from model.errors import InputFileError
from model.kinematics.articulated_object import ArticulatedObject, Part
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from model.kinematics.urdf_meshes import load_part
from model.kinematics.urdf_model import UrdfModel
from model.kinematics.urdf_reader import read_urdf_model


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

    def load(self, object_id: str) -> GroundTruth:
        """Read one object: see :func:`read_partnet_mobility`."""
        return read_partnet_mobility(Path(self.root) / object_id)


def read_partnet_mobility(folder: Path) -> GroundTruth:
    """Read one PartNet-Mobility folder.

    Returns:
        The object in the URDF's root frame (+z up, metres as written), q = 0.

    Raises:
        InputFileError: where ``mobility.urdf`` or a mesh is missing or broken.
    """
    folder = Path(folder)
    model = read_urdf_model(folder / "mobility.urdf")
    names = _semantic_names(folder)
    notes = list(model.notes)
    parts: list[Part] = []
    rename: dict[str, str] = {}
    for head, links in _rigid_groups(model.tree).items():
        visuals = [v for link in links for v in model.by_link.get(link, ())]
        if not visuals:
            rename[head] = head
            continue
        shown = [link for link in links if link in model.by_link]
        # The part is called after the link that the annotators named, else its first link.
        link = next((n for n in links if n in names), shown[0])
        rename[head] = link if link.startswith("link_") else f"link_{link}"
        parts.append(replace(load_part(rename[head], visuals), name=names.get(link)))
        if len(shown) > 1:
            notes.append(f"{rename[head]}: merged from {', '.join(shown)}")
    if not parts:
        raise InputFileError(model.path, "no link has a mesh", "at least one is needed")
    tree = _moving_tree(model, rename)
    meta = _json(folder / "meta.json")
    category = meta.get("model_cat") if isinstance(meta, dict) else None
    obj = ArticulatedObject(
        folder.name, tuple(sorted(parts, key=lambda p: _natural(p.link))), tree, category
    )
    return GroundTruth(folder.name, obj, tuple(notes))


def _rigid_groups(tree: KinematicTree) -> dict[str, list[str]]:
    """The topmost link of each rigid group → its links, parents first."""
    head: dict[str, str] = {}
    out: dict[str, list[str]] = {}
    for link in tree.order:
        joint = tree.joint_of.get(link)
        fixed = joint is not None and not joint.moves
        head[link] = head[joint.parent] if joint is not None and fixed else link
        out.setdefault(head[link], []).append(link)
    return out


def _moving_tree(model: UrdfModel, rename: Mapping[str, str]) -> KinematicTree:
    """The tree over rigid groups, without an empty root that only carries the whole object."""
    group = {link: head for head, links in _rigid_groups(model.tree).items() for link in links}
    joints = [
        replace(j, parent=rename[group[j.parent]], child=rename[group[j.child]])
        for j in model.tree.joints
        if j.moves
    ]
    links = list(rename.values())
    root = rename[group[model.tree.root]]
    below = [j for j in joints if j.parent == root]
    if not root.startswith("link_") and len(below) == 1:
        links.remove(root)
        joints.remove(below[0])
    return KinematicTree(tuple(links), tuple(_unmimicked(joints)))


def _unmimicked(joints: list[Joint]) -> list[Joint]:
    """Without mimics whose leader was dropped."""
    names = {j.name for j in joints}
    return [
        j if j.mimic is None or j.mimic.joint in names else replace(j, mimic=None) for j in joints
    ]


def _natural(name: str) -> tuple[int, str]:
    digits = name.removeprefix("link_")
    return (int(digits), "") if digits.isdigit() else (1 << 30, name)


def _json(path: Path) -> object:
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputFileError(path, f"not JSON: {error}") from None


def _semantic_names(folder: Path) -> dict[str, str]:
    """``link_k`` → part name, from semantics.txt, else from mobility_v2.json."""
    path = folder / "semantics.txt"
    if path.exists():
        rows = [line.split() for line in path.read_text(encoding="utf-8").splitlines()]
        return {r[0]: r[2] for r in rows if len(r) >= 3}
    nodes = _json(folder / "mobility_v2.json")
    if not isinstance(nodes, list):
        return {}
    return {f"link_{n['id']}": str(n["name"]) for n in nodes if "id" in n and n.get("name")}
