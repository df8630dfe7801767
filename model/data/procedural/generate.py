"""Procedural objects on the fly from a seed, or as folders that ``artiworld generate`` writes.

A folder has PartNet-Mobility's form and is read as such: ``mobility.urdf``,
``textured_objs/*.obj``, ``semantics.txt``, ``mobility_v2.json``, ``result.json`` and ``meta.json``,
as SAPIEN's data set has them: OBJ files are Y up with the front to +z, and the URDF's base joint
turns them to +z up with the front to -x.
"""

from __future__ import annotations

import json
import math
import zlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import numpy.typing as npt

from model.core.errors import ConfigurationError, InputFileError
from model.core.geometry import Mesh, affine, rotation_from_rpy
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.data.procedural.composite import random_composite
from model.data.procedural.corruption import FAULTS, corrupted
from model.data.procedural.families import FAMILIES, Family
from model.data.procedural.grammar import ProceduralObject
from model.data.registry import GroundTruth
from model.io.write import write_mesh

OBJ_FROM_OBJECT = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
"""From our frame (+z up, front -y) to the OBJ files' (+y up, front +z)."""
BASE_RPY = "1.570796326794897 0 -1.570796326794897"
COMPOSITE = "Composite"
HEAVY = frozenset(
    (
        "StorageFurniture",
        "Refrigerator",
        "Oven",
        "Microwave",
        "Dishwasher",
        "WashingMachine",
        "Safe",
        "Table",
    )
)
STATIC = frozenset(("Door", "Window", "Switch", "Faucet", "Toilet"))


@dataclass(frozen=True)
class GenerateSettings:
    """Settings of the generator.

    Attributes:
        out: the folder that gets one sub-folder an object.
        family: names of families in any case, or "all"; "Composite" is a random one.
        n: objects a family.
        seed: the same seed gives the same objects.
    """

    out: Path
    family: tuple[str, ...] = ("all",)
    n: int = 1
    seed: int = 0

    def __post_init__(self) -> None:
        if self.n < 1:
            raise ConfigurationError(f"n must be 1 or more, got {self.n}")


def family_names() -> tuple[str, ...]:
    """All names that :func:`make` takes."""
    return (*FAMILIES, COMPOSITE)


def make(family: str, seed: int, index: int = 0) -> ProceduralObject:
    """One object: the same arguments give the same object.

    Raises:
        ConfigurationError: for a family that isn't there.
    """
    maker = _family(family)
    rng = np.random.default_rng([seed, zlib.crc32(family.encode()), index])
    return maker(rng)


def generate(settings: GenerateSettings, progress: Progress = no_progress) -> tuple[Path, ...]:
    """Write ``n`` objects of each family.

    Returns:
        Their folders: ``<out>/<family>_<seed>_<index>``.

    Raises:
        ConfigurationError: for a family that isn't there.
    """
    names = family_names()
    if settings.family != ("all",):
        plain = {name.casefold(): name for name in names}
        names = tuple(plain.get(name.casefold(), name) for name in settings.family)
    for name in names:
        _family(name)
    out, total = [], len(names) * settings.n
    for name in names:
        for index in range(settings.n):
            progress(len(out) / total, f"{name} {index + 1} of {settings.n}")
            folder = settings.out / f"{name}_{settings.seed}_{index}"
            write_folder(make(name, settings.seed, index), folder)
            out.append(folder)
    progress(1.0, f"{total} objects")
    return tuple(out)


def _family(name: str) -> Family:
    if name == COMPOSITE:
        return random_composite
    if name not in FAMILIES:
        raise ConfigurationError(
            f"no family {name!r}; there are {', '.join(family_names())}, or all"
        )
    return FAMILIES[name]


def write_folder(made: ProceduralObject, folder: Path) -> None:
    """Write one object; files that are there are written over."""
    objs = folder / "textured_objs"
    objs.mkdir(parents=True, exist_ok=True)
    files: dict[str, list[tuple[str, str]]] = {}
    count = 0
    for part in made.object.parts:
        assert part.mesh is not None
        files[part.link] = []
        for piece, mesh in _by_piece(
            part.mesh, made.pieces[part.link], made.piece_names[part.link]
        ):
            stem = f"original-{count}"
            count += 1
            vertices = mesh.vertices @ OBJ_FROM_OBJECT.T
            write_mesh(replace(mesh, vertices=vertices), objs / f"{stem}.obj")
            files[part.link].append((stem, piece))
    (folder / "mobility.urdf").write_text(_urdf(made, files))
    (folder / "semantics.txt").write_text(_semantics(made))
    tree_ids, result = _result(made, files)
    for name, content in (
        ("mobility_v2.json", _mobility(made, tree_ids)),
        ("result.json", result),
        (
            "meta.json",
            {"model_cat": made.category, "anno_id": folder.name, "version": "procedural-1"},
        ),
    ):
        (folder / name).write_text(json.dumps(content, indent=1) + "\n")


def _by_piece(
    mesh: Mesh, pieces: npt.NDArray[np.int32], names: tuple[str, ...]
) -> list[tuple[str, Mesh]]:
    """The part's solids of the same name as one mesh each."""
    kinds = np.array(names)[pieces]
    return [(str(kind), mesh.take_faces(kinds == kind)) for kind in dict.fromkeys(kinds.tolist())]


def _numbers(values: npt.ArrayLike) -> str:
    return " ".join(f"{float(v) + 0.0:.9g}" for v in np.asarray(values))


def _urdf(made: ProceduralObject, files: Mapping[str, list[tuple[str, str]]]) -> str:
    tree = made.object.tree
    robot = ElementTree.Element("robot", name="procedural")
    ElementTree.SubElement(robot, "link", name="base")
    origin_of = {tree.root: np.zeros(3)}
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is not None:
            origin_of[link] = OBJ_FROM_OBJECT @ np.asarray(joint.origin)
        element = ElementTree.SubElement(robot, "link", name=link)
        for stem, piece in files.get(link, ()):
            for tag in ("visual", "collision"):
                shape = ElementTree.SubElement(element, tag)
                if tag == "visual":
                    shape.set("name", f"{piece}-{stem.split('-')[1]}")
                ElementTree.SubElement(shape, "origin", xyz=_numbers(-origin_of[link]))
                geometry = ElementTree.SubElement(shape, "geometry")
                ElementTree.SubElement(geometry, "mesh", filename=f"textured_objs/{stem}.obj")
        robot.append(_urdf_joint(tree.root, joint, origin_of))
    ElementTree.indent(robot)
    return '<?xml version="1.0" ?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def _urdf_joint(
    root: str, joint: Joint | None, origin_of: Mapping[str, npt.NDArray[np.float64]]
) -> ElementTree.Element:
    if joint is None:
        out = ElementTree.Element("joint", name="joint_base", type="fixed")
        ElementTree.SubElement(out, "origin", rpy=BASE_RPY, xyz="0 0 0")
        ElementTree.SubElement(out, "child", link=root)
        ElementTree.SubElement(out, "parent", link="base")
        return out
    out = ElementTree.Element("joint", name=joint.name, type=joint.type)
    xyz = _numbers(origin_of[joint.child] - origin_of[joint.parent])
    ElementTree.SubElement(out, "origin", xyz=xyz)
    ElementTree.SubElement(out, "axis", xyz=_numbers(OBJ_FROM_OBJECT @ np.asarray(joint.axis)))
    ElementTree.SubElement(out, "child", link=joint.child)
    ElementTree.SubElement(out, "parent", link=joint.parent)
    if joint.limited:
        ElementTree.SubElement(out, "limit", lower=f"{joint.lower:.9g}", upper=f"{joint.upper:.9g}")
    return out


def _kind(made: ProceduralObject, link: str) -> str:
    """PartNet-Mobility's word for how a link moves."""
    joint = made.object.tree.joint_of.get(link)
    if joint is None:
        return (
            "heavy" if made.category in HEAVY else "static" if made.category in STATIC else "free"
        )
    if joint.slides:
        return "slider" if joint.parent.startswith("link_") else "slider+"
    return "hinge" if joint.rotates else "static"


def _semantics(made: ProceduralObject) -> str:
    rows = [f"{p.link} {_kind(made, p.link)} {p.name or 'part'}" for p in made.object.parts]
    return "\n".join(rows) + "\n"


def _joint_data(joint: Joint | None, rotates: bool) -> dict[str, object]:
    if joint is None or not joint.moves:
        return {}
    axis = {
        "origin": [round(float(v), 9) for v in OBJ_FROM_OBJECT @ np.asarray(joint.origin)],
        "direction": [round(float(v), 9) for v in OBJ_FROM_OBJECT @ np.asarray(joint.axis)],
    }
    scale = 180.0 / math.pi if joint.rotates else 1.0
    low, high = (0.0 if v is None else v * scale for v in (joint.lower, joint.upper))
    out: dict[str, object] = {
        "axis": axis,
        "limit": {"a": high, "b": low, "noLimit": joint.type == "continuous"},
    }
    if rotates:
        out |= {"rotates": True, "noRotationLimit": True, "rotationLimit": 0}
    return out


def _mobility(made: ProceduralObject, tree_ids: Mapping[str, int]) -> list[dict[str, object]]:
    tree, out = made.object.tree, []
    names = {p.link: p.name or "part" for p in made.object.parts}
    for link in (name for name in tree.order if name.startswith("link_")):
        joint = tree.joint_of.get(link)
        kind = _kind(made, link)
        parent = -1
        if joint is not None:
            bearer = joint.parent
            while not bearer.startswith("link_"):
                bearer = tree.joint_of[bearer].parent
            parent = int(bearer.removeprefix("link_"))
        out.append(
            {
                "id": int(link.removeprefix("link_")),
                "parent": parent,
                "name": names[link],
                "joint": kind.removesuffix("+"),
                "parts": [{"id": tree_ids[link], "name": names[link], "children": []}],
                "jointData": _joint_data(joint, kind.endswith("+")),
            }
        )
    return out


def _result(
    made: ProceduralObject, files: Mapping[str, list[tuple[str, str]]]
) -> tuple[dict[str, int], list[dict[str, object]]]:
    """Ids of the parts in the tree of ``result.json``, and the tree."""
    ids: dict[str, int] = {}
    children: list[dict[str, object]] = []
    count = 1
    for part in made.object.parts:
        ids[part.link] = count
        count += 1
        leaves: list[dict[str, object]] = []
        for stem, piece in files[part.link]:
            leaves.append({"id": count, "name": piece, "text": piece, "objs": [stem]})
            count += 1
        name = part.name or "part"
        children.append({"id": ids[part.link], "name": name, "text": name, "children": leaves})
    root: dict[str, object] = {
        "id": 0,
        "name": made.category.lower(),
        "text": made.category,
        "children": children,
    }
    return ids, [root]


SEEDS = 10**9


@dataclass(frozen=True)
class ProceduralSet:
    """``n`` objects of each family; the same seed gives the same objects.

    Attributes:
        seed: random seed; ids are ``<family>_<seed>_<index>``, as ``generate`` names folders.
        n: objects a family.
        families: names of families; all of them where empty.
        fault: one of :data:`~model.data.procedural.corruption.FAULTS`, "" for clean meshes.
    """

    seed: int = 0
    n: int = 1
    families: tuple[str, ...] = ()
    name: str = "procedural"
    fault: str = ""

    def __post_init__(self) -> None:
        if self.n < 1:
            raise ConfigurationError(f"n must be 1 or more, got {self.n}")
        if not 0 <= self.seed < SEEDS:
            raise ConfigurationError(f"the seed must be 0..{SEEDS - 1}, got {self.seed}")
        unknown = sorted(set(self.families) - set(family_names()))
        if unknown:
            known = ", ".join(family_names())
            raise ConfigurationError(f"no family {unknown[0]!r}; there are {known}")
        if self.fault and self.fault not in FAULTS:
            raise ConfigurationError(f"no fault {self.fault!r}; there are {', '.join(FAULTS)}")

    def ids(self) -> tuple[str, ...]:
        """All of them, sorted by family."""
        names = sorted(self.families or family_names())
        return tuple(f"{f}_{self.seed}_{i}" for f in names for i in range(self.n))

    def category(self, object_id: str) -> str | None:
        """The family."""
        return object_id.rsplit("_", 2)[0]

    def load(self, object_id: str) -> GroundTruth:
        """Make one object, its front to -x as PartNet-Mobility's objects stand.

        Raises:
            InputFileError: where ``object_id`` isn't ``<family>_<seed>_<index>``.
        """
        try:
            family, seed, index = object_id.rsplit("_", 2)
            made = make(family, int(seed), int(index))
        except ValueError:
            raise InputFileError(
                object_id, "names no procedural object", "write <family>_<seed>_<index>"
            ) from None
        turn = affine(rotation_from_rpy((np.pi / 2, 0, -np.pi / 2)) @ OBJ_FROM_OBJECT)
        made = replace(made, object=made.object.moved(turn))
        if self.fault:
            rng = np.random.default_rng([int(seed), int(index), 11])
            return corrupted(made, FAULTS[self.fault], rng, name=object_id)
        return GroundTruth(object_id, made.object)
