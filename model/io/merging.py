"""Parts that don't move against each other become one.

"Over-segmented annotations are merged, and only parts that take part in articulation are kept"
(*ArtiWorld*, section on data). The same is done to predictions before their parts are compared, so
that a door in three pieces is one door on both sides.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from model.core.articulated_object import ArticulatedObject, Inertial, Part, remarks_of, together
from model.core.errors import InputFileError, KinematicsError
from model.core.geometry import merged, merged_clouds
from model.core.joint import Joint
from model.core.shapes import Shape
from model.core.tree import KinematicTree
from model.io.formats.mtl import MaterialFiles
from model.io.urdf.files import MOBILITY, description_beside, partnet_category, semantic_names
from model.io.urdf.meshes import DeclaredCollision, declared_shapes, load_part
from model.io.urdf.model import UrdfModel
from model.io.urdf.reader import read_urdf_model


def read_rigid(
    path: Path, name: str | None = None, *, root: Path | None = None, shapes: bool = False
) -> tuple[ArticulatedObject, UrdfModel, tuple[str, ...]]:
    """Read a URDF with what lies beside it and tells names and a category; see
    :func:`merge_rigid`.

    Args:
        path: the file; ``mobility.urdf`` has PartNet-Mobility's files beside it, others may have an
            ``object.json``.
        name: of the object; by default the file's.
        root: the folder that references must not leave; by default as ``read_urdf_model``.
        shapes: whether to load the collision shapes that it tells, too.

    Returns:
        The object in the URDF's root frame (+z up, metres as written) at q = 0, what was read, and
        human-readable remarks.

    Raises:
        InputFileError: where the URDF or a mesh is missing or broken.
    """
    model, folder = read_urdf_model(path, root=root), path.parent
    files = MaterialFiles(folder)  # textures may lie beside the meshes' folder
    parts = {
        link: replace(load_part(link, visuals, files), name=None)
        for link, visuals in model.by_link.items()
    }
    if not parts:
        raise InputFileError(path, "no link has a mesh", "at least one is needed")
    if path.name == MOBILITY:
        category, names = partnet_category(folder), semantic_names(folder)
    else:
        said = description_beside(path)
        category, listed = (said.get(key) for key in ("category", "names"))
        pairs = listed.items() if isinstance(listed, dict) else ()
        names = {link: str(label) for link, label in pairs if link in parts}
    obj, merges = merge_rigid(
        name or path.stem,
        model.tree,
        parts,
        names=names,
        category=category if isinstance(category, str) else None,
        inertials=model.declared.inertials,
        collision=model.declared.collision if shapes else None,
    )
    return obj, model, (*model.notes, *merges)


def merge_rigid(
    name: str,
    tree: KinematicTree,
    parts: Mapping[str, Part],
    *,
    names: Mapping[str, str] | None = None,
    category: str | None = None,
    apart: Collection[str] = (),
    inertials: Mapping[str, Inertial] | None = None,
    collision: Mapping[str, DeclaredCollision] | None = None,
) -> tuple[ArticulatedObject, tuple[str, ...]]:
    """The object with one part for each group of links that move together.

    A group is called after its first link with a name in ``names``, else after its first link with
    geometry, with ``link_`` before it where that is missing. An empty root that only carries the
    whole object is left out.

    Args:
        name: of the object.
        tree: over all links, object frame.
        parts: link → its geometry; links without any are helpers.
        names: link → display name.
        category: of the object.
        apart: names of fixed joints whose two sides stay two parts.
        inertials: link → declared mass properties; those of a group are combined, where they are
            declared for all of its visible links.
        collision: link → declared collision shapes; a group has those of all its links. Shapes
            that can't be loaded are among its part's remarks.

    Returns:
        The object, and human-readable remarks on the merged links.

    Raises:
        KinematicsError: where no link has geometry.
    """
    names = names or {}
    if not parts:
        raise KinematicsError([f"{name}: no link has geometry; at least one is needed"])
    groups = rigid_groups(tree, apart)
    rename: dict[str, str] = {}
    out: list[Part] = []
    notes: list[str] = []
    weighed: dict[str, Inertial] = {}
    shaped: dict[str, tuple[Shape, ...]] = {}
    for head, links in groups.items():
        shown = [link for link in links if link in parts]
        if not shown:
            rename[head] = _helper(head)
            continue
        chosen = next((n for n in links if n in names), shown[0])
        link = rename[head] = chosen if chosen.startswith("link_") else f"link_{chosen}"
        label = names.get(chosen, parts[shown[0]].name if len(shown) == 1 else None)
        remarks: list[str] = []
        shapes = declared_shapes(links, collision or {}, remarks)
        if shapes:
            shaped[link] = shapes
        joined = _joined(link, [parts[s] for s in shown], label)
        out.append(replace(joined, remarks=(*joined.remarks, *remarks)))
        own = group_inertial(links, parts, inertials or {})
        if own is not None:
            weighed[link] = own
        if len(shown) > 1:
            notes.append(f"{link}: merged from {', '.join(shown)}")
    made = _moving_tree(tree, groups, rename)
    parts_in_order = tuple(sorted(out, key=lambda p: _natural(p.link)))
    return ArticulatedObject(name, parts_in_order, made, category, weighed, shaped), tuple(notes)


def group_inertial(
    links: Sequence[str], seen: Collection[str], declared: Mapping[str, Inertial]
) -> Inertial | None:
    """Combined inertial of links that are fixed to each other; None unless it is declared for all
    of them that can be seen: a handle's mass alone is not its door's."""
    own = [declared[link] for link in links if link in declared]
    return (
        together(own) if own and all(link in declared for link in links if link in seen) else None
    )


def rigid_groups(tree: KinematicTree, apart: Collection[str] = ()) -> dict[str, list[str]]:
    """The topmost link of each rigid group → its links, parents first."""
    head: dict[str, str] = {}
    out: dict[str, list[str]] = {}
    for link in tree.order:
        joint = tree.joint_of.get(link)
        if joint is None or joint.moves or joint.name in apart:
            head[link] = link
        else:
            head[link] = head[joint.parent]
        out.setdefault(head[link], []).append(link)
    return out


def _joined(link: str, parts: Sequence[Part], name: str | None) -> Part:
    meshes = [p.mesh for p in parts if p.mesh is not None]
    clouds = [p.cloud for p in parts if p.cloud is not None]
    return Part(
        link,
        merged(meshes) if meshes else None,
        merged_clouds(clouds) if clouds else None,
        name,
        remarks_of(parts),
    )


def _helper(link: str) -> str:
    return f"helper_{link.removeprefix('link_')}" if link.startswith("link_") else link


def _moving_tree(
    tree: KinematicTree, groups: Mapping[str, Sequence[str]], rename: Mapping[str, str]
) -> KinematicTree:
    """The tree over rigid groups, without an empty root that only carries the whole object."""
    group = {link: head for head, links in groups.items() for link in links}
    joints = [
        replace(j, parent=rename[group[j.parent]], child=rename[group[j.child]])
        for j in tree.joints
        if group[j.parent] != group[j.child]
    ]
    links = list(rename.values())
    root = rename[group[tree.root]]
    below = [j for j in joints if j.parent == root]
    if not root.startswith("link_") and len(below) == 1:
        links.remove(root)
        joints.remove(below[0])
    return KinematicTree(tuple(links), tuple(_unmimicked(joints)))


def _unmimicked(joints: Sequence[Joint]) -> list[Joint]:
    """Drop mimics whose leader was dropped."""
    names = {j.name for j in joints}
    return [
        j if j.mimic is None or j.mimic.joint in names else replace(j, mimic=None) for j in joints
    ]


def _natural(name: str) -> tuple[int, str]:
    digits = name.removeprefix("link_")
    return (int(digits), "") if digits.isdecimal() else (1 << 30, name)
