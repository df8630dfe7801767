"""Articulated objects from other sources as an asset: parts, names and joints.

What a URDF or MJCF fixes together is one part, as for a data set. Unlike there, the order of the
elements is the file's, and an empty root keeps its joints: whoever checks a file wants to see them
all.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, Inertial, Part, remarks_of
from model.core.asset import MAX_PARTS
from model.core.errors import InputFileError
from model.core.geometry import Mesh, PointCloud, merged, merged_clouds
from model.core.progress import Progress, no_progress
from model.core.shapes import Shape, moved_shape
from model.core.tree import KinematicTree
from model.io.assets.reader import PROVENANCE, URDF, declared_links, load_object, reading_notes
from model.io.export.manifest import declared_category
from model.io.file_names import part_name_in, part_of_file_name
from model.io.formats.loaded import size_of
from model.io.formats.mtl import MaterialFiles
from model.io.merging import group_inertial, rigid_groups
from model.io.model_files import read_model
from model.io.urdf.files import (
    MOBILITY,
    description_beside,
    package_root,
    partnet_category,
    semantic_names,
)
from model.io.urdf.meshes import DeclaredCollision, declared_shapes, load_part
from model.io.urdf.model import UrdfModel

_NOTES_SHOWN = 6


@dataclass(frozen=True, eq=False)
class Opened:
    """An articulated object with its parts numbered as in the app.

    Attributes:
        mesh, cloud: all geometry in the file's order; one of them.
        element_part: (E,) int32 part of each face or point; None where there is but one part.
        part_names: by part, "" for none.
        tree: joints of the links ``link_<part>`` and of helpers; None where none moves.
        notes: human-readable remarks on content changed or skipped on reading.
        files: what was read.
        inertials: by those links, mass properties where the file tells them.
        shapes: by those links, collision shapes where the file tells them.
    """

    mesh: Mesh | None
    cloud: PointCloud | None
    element_part: npt.NDArray[np.int32] | None
    part_names: tuple[str, ...]
    tree: KinematicTree | None
    category: str | None
    notes: tuple[str, ...]
    files: tuple[Path, ...]
    inertials: Mapping[str, Inertial]
    shapes: Mapping[str, tuple[Shape, ...]]


def open_model(
    path: Path,
    target_from_file: npt.NDArray[np.float64],
    max_bytes: int,
    progress: Progress = no_progress,
    model: UrdfModel | None = None,
    given: Path | None = None,
) -> Opened:
    """Read a URDF, MJCF or USD with what lies beside it and tells more: names, a category.

    Args:
        path: the file; its meshes lie in its folder, or in that of its ROS package.
        target_from_file: (4, 4) rotation and uniform scale to metres and +z up.
        max_bytes: refuse larger meshes.
        progress: reports each link.
        model: what was read of the file already, or None.
        given: folder that a person gave, which its meshes may lie in, too.

    Raises:
        InputFileError: naming the file and everything that is wrong in it.
    """
    model = model or read_model(path, max_bytes, given)
    for visual in model.visuals:
        if visual.file is not None and visual.file.is_file():
            size_of(visual.file, max_bytes)
    files = MaterialFiles(package_root(path, given))
    if path.name == URDF and (path.parent / PROVENANCE).is_file():
        obj = load_object(path.parent, progress)
        names_of = {p.link: p.name for p in obj.parts if p.name}
        notes = reading_notes(path.parent, obj)
    else:
        obj, names_of = _loaded(model, files, progress)
        obj = replace(model.declared, collision={}).of(obj)  # those go by part, not by link
        notes = (*model.notes, *model.declared.notes, *remarks_of(obj.parts))
    plain = {*model.rescaled, *model.renamed}  # no effect on geometry or joints
    notes = tuple(n for n in dict.fromkeys(notes) if n not in plain)
    meshes = [v.file for v in model.visuals if v.file is not None]
    collision = model.declared.collision
    meshes += [
        v.file
        for c in collision.values()
        for v in c.pieces
        if v.file is not None and v.file.is_file()
    ]
    listed = declared_links(path.parent, "collision") if path.name == URDF else None
    if listed is not None:  # a saved asset computes the others from its geometry
        collision = {
            link: c if link in listed else replace(c, repeated=True)
            for link, c in collision.items()
        }
    files_read = (path, *meshes, *model.files, *files.paths)
    return _opened(obj, names_of, collision, target_from_file, notes, files_read)


def _loaded(
    model: UrdfModel, files: MaterialFiles, progress: Progress
) -> tuple[ArticulatedObject, dict[str, str]]:
    """The object by link, and the part names given by files beside the URDF."""
    path = model.path
    parts = []
    for i, (link, visuals) in enumerate(model.by_link.items()):
        progress(i / len(model.by_link), f"reading {link}")
        parts.append(load_part(link, visuals, files))
    if not parts:
        raise InputFileError(path, "no link has a visual or a collision mesh", "one is needed")
    if path.name == MOBILITY:
        category, names_of = partnet_category(path.parent), semantic_names(path.parent)
    else:
        said = description_beside(path)
        category, names = said.get("category") or model.category, said.get("names")
        names_of = {k: str(v) for k, v in names.items()} if isinstance(names, dict) else {}
        exported, ours = declared_category(path.parent)
        if ours:  # exports of ArtiWorld name links, and visuals where they can, after parts
            category = category or exported
            own = {p.link: _named(p.name) or part_name_in(p.link) for p in parts}
            names_of = {link: name for link, name in own.items() if name} | names_of
        names_of = dict(model.part_names) | names_of
    known = category if isinstance(category, str) else None
    return ArticulatedObject(model.name, tuple(parts), model.tree, known), names_of


def _named(visual: str | None) -> str | None:
    """A visual's name where it is a part's: in SDF each needs one."""
    return None if visual is None or re.fullmatch(r"visual(_\d+)?", visual) else visual


def _opened(
    obj: ArticulatedObject,
    names_of: Mapping[str, str],
    collision: Mapping[str, DeclaredCollision],
    matrix: npt.NDArray[np.float64],
    notes: Sequence[str],
    files: Sequence[Path],
) -> Opened:
    path, said = files[0], list(notes)
    meshes, clouds = _geometry(path, obj.parts)
    sizes = [len(m.faces) for m in meshes] or [len(c) for c in clouds]
    mesh = merged(meshes).moved(matrix) if meshes else None
    cloud = merged_clouds(clouds).moved(matrix) if clouds else None
    tree = _without_bare_ends(obj.tree, {p.link for p in obj.parts}, said)
    moves = any(j.moves for j in tree.joints)
    # Without moving joints the links are the only parts; they stay apart for the predictor.
    apart = () if moves else [j.name for j in tree.joints]
    groups = rigid_groups(tree, apart)
    head = {link: top for top, links in groups.items() for link in links}
    holding = {head[p.link] for p in obj.parts}
    number = _numbers([top for top in groups if top in holding], tree.root, names_of)
    if max(number.values()) >= MAX_PARTS:
        raise InputFileError(path, f"has {len(number)} parts; {MAX_PARTS - 1} are possible")
    parts = np.repeat([number[head[p.link]] for p in obj.parts], sizes).astype(np.int32)
    names = [""] * (max(number.values()) + 1)
    own = {p.link for p in obj.parts}
    for top, part in number.items():
        names[part] = _name([n for n in groups[top] if n in names_of or n in own], names_of)
    # Links without geometry still have mass, and may have collision shapes.
    declared_groups = rigid_groups(obj.tree, apart)
    shapes = _shaped(declared_groups, collision, number, matrix, said)
    return Opened(
        mesh,
        cloud,
        parts if len(number) > 1 or moves else None,
        tuple(names) if len(number) > 1 or moves else (),
        _numbered(tree, groups, head, number, matrix) if moves else None,
        obj.category,
        (
            *said[:_NOTES_SHOWN],
            *([f"and {len(said) - _NOTES_SHOWN} remarks more"] if len(said) > _NOTES_SHOWN else []),
        ),
        tuple(dict.fromkeys(files)),
        _weighed(obj, declared_groups, number, matrix),
        shapes,
    )


def _geometry(path: Path, parts: Sequence[Part]) -> tuple[list[Mesh], list[PointCloud]]:
    """The meshes of all parts, or the clouds of all; an asset is one or the other."""
    meshes = [p.mesh for p in parts if p.mesh is not None]
    if len(meshes) == len(parts):
        return meshes, []
    if meshes:
        cloud = next(p.link for p in parts if p.mesh is None)
        raise InputFileError(
            path,
            f"link {cloud!r} is a cloud among meshes",
            "give all links as meshes or all as clouds",
        )
    return [], [p.cloud for p in parts if p.cloud is not None]


def _without_bare_ends(tree: KinematicTree, holding: set[str], notes: list[str]) -> KinematicTree:
    """Drop moving leaf links without geometry: tool frames, sensors."""
    needed = set(holding) | {tree.root}
    leaders = {j.mimic.joint for j in tree.joints if j.mimic is not None}
    needed |= {j.child for j in tree.joints if j.name in leaders}
    for link in list(needed):
        while (joint := tree.joint_of.get(link)) is not None:
            needed.add(link := joint.parent)
    bare = [j for j in tree.joints if j.child not in needed]
    moving = [j.name for j in bare if j.moves]
    if moving:
        notes.append(
            f"joints that carry nothing were left out: {', '.join(moving[:5])}"
            + (", …" if len(moving) > 5 else "")
        )
    if not bare:
        return tree
    gone = {j.child for j in bare}
    joints = tuple(j for j in tree.joints if j.child not in gone)
    return KinematicTree(tuple(n for n in tree.links if n not in gone), joints)


def _numbers(tops: Sequence[str], root: str, names_of: Mapping[str, str]) -> dict[str, int]:
    """Topmost link of each part → its number; 0 is the base.

    Objects that the app wrote keep the numbers that they have there.
    """
    named = {top: part_of_file_name(top, names_of.get(top)) for top in tops}
    kept = {top: n for top, n in named.items() if n is not None and n < MAX_PARTS}
    based = kept.get(root) == 0 if root in tops else 0 not in kept.values()
    if len(set(kept.values())) == len(tops) and based:
        return kept
    first = 0 if tops[0] == root else 1
    return {top: first + i for i, top in enumerate(tops)}


def _name(links: Sequence[str], names_of: Mapping[str, str]) -> str:
    """Name of a part: the declared one, else its first link's, unless that is a number."""
    chosen = next((n for n in links if n in names_of), None)
    if chosen is not None:
        return names_of[chosen]
    plain = links[0].removeprefix("link_")
    return "" if plain.isdecimal() and plain != links[0] else plain


def _numbered(
    tree: KinematicTree,
    groups: Mapping[str, Sequence[str]],
    head: Mapping[str, str],
    number: Mapping[str, int],
    matrix: npt.NDArray[np.float64],
) -> KinematicTree:
    """The moving joints between the parts, under ``matrix``."""
    link = {top: f"link_{number[top]}" if top in number else top for top in groups}
    joints = [
        replace(j, parent=link[head[j.parent]], child=link[head[j.child]])
        for j in tree.moved(matrix).joints
        if j.moves
    ]
    return KinematicTree(tuple(link.values()), tuple(joints))


def _weighed(
    obj: ArticulatedObject,
    groups: Mapping[str, Sequence[str]],
    number: Mapping[str, int],
    matrix: npt.NDArray[np.float64],
) -> dict[str, Inertial]:
    """Link of each part, or helper → the combined inertial of its links."""
    names_of, seen = obj.inertials, {p.link for p in obj.parts}
    out: dict[str, Inertial] = {}
    for top, links in groups.items():
        own = group_inertial(links, seen, names_of)
        if own is not None:
            out[f"link_{number[top]}" if top in number else top] = own.moved(matrix)
    return out


def _shaped(
    groups: Mapping[str, Sequence[str]],
    collision: Mapping[str, DeclaredCollision],
    number: Mapping[str, int],
    matrix: npt.NDArray[np.float64],
    notes: list[str],
) -> dict[str, tuple[Shape, ...]]:
    """Link of each part, or helper → the collision shapes of its links."""
    out: dict[str, tuple[Shape, ...]] = {}
    for top, links in groups.items():
        held = declared_shapes(links, collision, notes)
        if held:
            link = f"link_{number[top]}" if top in number else top
            out[link] = tuple(moved_shape(s, matrix) for s in held)
    return out
