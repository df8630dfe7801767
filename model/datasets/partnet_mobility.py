"""PartNet-Mobility folders (SAPIEN): ``mobility.urdf`` leads, names come from beside it.

The URDF wins over ``mobility_v2.json`` where the two disagree, because some were corrected by
hand. Links that are fixed to each other are one rigid part ("over-segmented annotations are
merged, and only parts that take part in articulation are kept", ArtiWorld, section on data).
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import numpy.typing as npt

from model.datasets.protocol import GroundTruth
from model.errors import InputFileError
from model.geometry.mesh import Mesh
from model.kinematics.articulated_object import ArticulatedObject, Part
from model.kinematics.joint import JOINT_TYPES, Joint
from model.kinematics.tree import KinematicTree

Matrix = npt.NDArray[np.float64]


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
        The object in the URDF's base frame (+z up, metres as written), q = 0.

    Raises:
        InputFileError: where ``mobility.urdf`` or a mesh is missing or broken.
    """
    urdf = _Urdf.read(folder / "mobility.urdf")
    pose = urdf.rest_poses()
    group = urdf.rigid_groups()
    names = _semantic_names(folder)
    members: dict[str, list[str]] = {}
    for link, head in group.items():
        members.setdefault(head, []).append(link)
    parts, notes = [], []
    rename: dict[str, str] = {}
    for head, links in members.items():
        pieces = [m for link in links for m in urdf.link_meshes(link, pose[link])]
        if not pieces:
            rename[head] = _helper_name(head)
            continue
        # The part is called after the link that the annotators named, else its first link.
        link = next((n for n in links if n in names), next(iter(links)))
        rename[head] = link if link.startswith("link_") else f"link_{link}"
        parts.append(Part(rename[head], mesh=_join(pieces), name=names.get(link)))
        if len(links) > 1 and sum(bool(urdf.visuals(x)) for x in links) > 1:
            notes.append(f"{rename[head]}: merged from {', '.join(links)}")
    if not parts:
        raise InputFileError(urdf.path, "no link has a mesh", "at least one is needed")
    joints = urdf.joints_in_rest_frame(pose, group, rename)
    links, joints, dropped = _without_empty_root(tuple(rename.values()), joints)
    notes += dropped
    meta = _json(folder / "meta.json")
    obj = ArticulatedObject(
        folder.name,
        tuple(sorted(parts, key=lambda p: _natural(p.link))),
        KinematicTree(links, joints),
        meta.get("model_cat") if isinstance(meta, dict) else None,
    )
    return GroundTruth(folder.name, obj, tuple(notes))


@dataclass(frozen=True)
class _Urdf:
    """The few things that are read from a PartNet-Mobility URDF."""

    path: Path
    links: Mapping[str, Element]
    joints: tuple[Element, ...]
    parent_joint: Mapping[str, Element] = field(default_factory=dict)

    @staticmethod
    def read(path: Path) -> _Urdf:
        from defusedxml.ElementTree import ParseError, parse

        try:
            root = parse(path).getroot()
        except FileNotFoundError:
            raise InputFileError(
                path, "no such file", "a PartNet-Mobility folder has one"
            ) from None
        except ParseError as error:
            raise InputFileError(path, f"not XML: {error}", "a URDF is an XML file") from None
        links = {e.get("name", ""): e for e in root.findall("link")}
        joints = tuple(root.findall("joint"))
        out = _Urdf(path, links, joints, {_end(j, "child"): j for j in joints})
        for j in joints:
            for end in ("parent", "child"):
                if _end(j, end) not in links:
                    raise InputFileError(
                        path,
                        f"joint {j.get('name')!r} names the {end} link {_end(j, end)!r}",
                        f"links are {', '.join(links)}",
                    )
            if j.get("type") not in JOINT_TYPES:
                raise InputFileError(
                    path,
                    f"joint {j.get('name')!r} has type {j.get('type')!r}",
                    f"one of {', '.join(JOINT_TYPES)} is read",
                )
        return out

    def rest_poses(self) -> dict[str, Matrix]:
        """Link → (4, 4) ``world_from_link`` with every joint at 0."""
        out: dict[str, Matrix] = {}

        def pose(link: str, depth: int = 0) -> Matrix:
            if link not in out:
                if depth > len(self.links):
                    raise InputFileError(self.path, f"a cycle through link {link!r}")
                j = self.parent_joint.get(link)
                out[link] = (
                    np.eye(4)
                    if j is None
                    else pose(_end(j, "parent"), depth + 1) @ self._origin(j.find("origin"))
                )
            return out[link]

        for name in self.links:
            pose(name)
        return out

    def rigid_groups(self) -> dict[str, str]:
        """Link → the topmost link that it is fixed to."""

        def head(link: str) -> str:
            j = self.parent_joint.get(link)
            while j is not None and j.get("type") == "fixed":
                link = _end(j, "parent")
                j = self.parent_joint.get(link)
            return link

        return {link: head(link) for link in self.links}

    def visuals(self, link: str) -> list[Element]:
        return self.links[link].findall("visual")

    def link_meshes(self, link: str, world_from_link: Matrix) -> list[Mesh]:
        out = []
        for visual in self.visuals(link):
            mesh = self._geometry(visual)
            if mesh is None or not len(mesh.faces):
                continue
            m = world_from_link @ self._origin(visual.find("origin"))
            out.append(replace(mesh, vertices=mesh.vertices @ m[:3, :3].T + m[:3, 3]))
        return out

    def _geometry(self, visual: Element) -> Mesh | None:
        mesh = visual.find("geometry/mesh")
        if mesh is not None:
            path = self.path.parent / mesh.get("filename", "")
            scale = self._numbers(mesh.get("scale"), (1.0, 1.0, 1.0))
            loaded = _read_obj(path)
            return replace(loaded, vertices=loaded.vertices * scale)
        box = visual.find("geometry/box")
        if box is not None:
            import trimesh

            shape = trimesh.creation.box(self._numbers(box.get("size"), (1.0, 1.0, 1.0)))
            return Mesh(np.asarray(shape.vertices), np.asarray(shape.faces, np.int32))
        return None

    def _origin(self, element: Element | None) -> Matrix:
        out = np.eye(4)
        if element is None:
            return out
        out[:3, 3] = self._numbers(element.get("xyz"), (0.0, 0.0, 0.0))
        roll, pitch, yaw = self._numbers(element.get("rpy"), (0.0, 0.0, 0.0))
        cr, sr, cp, sp = np.cos(roll), np.sin(roll), np.cos(pitch), np.sin(pitch)
        cy, sy = np.cos(yaw), np.sin(yaw)
        out[:3, :3] = [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
        return out

    def _numbers(
        self, text: str | None, default: tuple[float, float, float]
    ) -> npt.NDArray[np.float64]:
        if text is None:
            return np.array(default)
        try:
            out = np.array([float(v) for v in text.split()])
        except ValueError:
            out = np.zeros(0)
        if out.shape != (3,) or not np.isfinite(out).all():
            raise InputFileError(self.path, f"{text!r} is not three numbers")
        return out

    def joints_in_rest_frame(
        self, pose: Mapping[str, Matrix], group: Mapping[str, str], rename: Mapping[str, str]
    ) -> tuple[Joint, ...]:
        out = []
        for j in self.joints:
            kind = j.get("type")
            if kind == "fixed":
                continue
            parent, child = _end(j, "parent"), _end(j, "child")
            world_from_child = pose[child]
            element = j.find("axis")
            axis = self._numbers(None if element is None else element.get("xyz"), (1.0, 0.0, 0.0))
            limit = j.find("limit")
            low, high = 0.0, 0.0
            if limit is not None:
                low, high = (float(limit.get(k, "0")) for k in ("lower", "upper"))
            out.append(
                Joint(
                    j.get("name", f"joint_{len(out)}"),
                    kind,  # type: ignore[arg-type]
                    rename[group[parent]],
                    rename[group[child]],
                    tuple(world_from_child[:3, :3] @ axis),  # type: ignore[arg-type]
                    tuple(world_from_child[:3, 3]),  # type: ignore[arg-type]
                    min(low, high),
                    max(low, high),
                )
            )
        return tuple(out)


def _without_empty_root(
    links: tuple[str, ...], joints: tuple[Joint, ...]
) -> tuple[tuple[str, ...], tuple[Joint, ...], list[str]]:
    """Drop helper roots that carry nothing and have one child: the frame they stood for."""
    children = {j.child for j in joints}
    roots = [link for link in links if link not in children]
    if len(roots) == 1 and not roots[0].startswith("link_"):
        kids = [j for j in joints if j.parent == roots[0]]
        if len(kids) == 1:
            links = tuple(x for x in links if x != roots[0])
            return (
                links,
                tuple(j for j in joints if j is not kids[0]),
                [f"{kids[0].name}: it moves the whole object and was left out"],
            )
    return links, joints, []


def _end(joint: Element, which: str) -> str:
    element = joint.find(which)
    return "" if element is None else element.get("link", "")


def _helper_name(link: str) -> str:
    return f"helper_{link.removesuffix('_helper').removeprefix('link_')}"


def _natural(name: str) -> tuple[int, str]:
    digits = name.removeprefix("link_")
    return (int(digits), "") if digits.isdigit() else (1 << 30, name)


def _json(path: Path) -> object:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return {}
    except ValueError as error:
        raise InputFileError(path, f"not JSON: {error}") from None


def _semantic_names(folder: Path) -> dict[str, str]:
    """``link_k`` → part name, from semantics.txt, else from mobility_v2.json."""
    path = folder / "semantics.txt"
    if path.exists():
        rows = [line.split() for line in path.read_text().splitlines()]
        return {r[0]: r[2] for r in rows if len(r) >= 3}
    nodes = _json(folder / "mobility_v2.json")
    if not isinstance(nodes, list):
        return {}
    return {f"link_{n['id']}": n["name"] for n in nodes if "id" in n and n.get("name")}


def _read_obj(path: Path) -> Mesh:
    """Triangles of an OBJ, without its materials (a predictor reads geometry alone)."""
    import trimesh

    try:
        loaded = trimesh.load(
            path, file_type="obj", process=False, skip_materials=True, force="mesh"
        )
    except (FileNotFoundError, ValueError, IndexError) as error:
        raise InputFileError(path, f"can't be read: {error}", "a Wavefront OBJ is needed") from None
    if not isinstance(loaded, trimesh.Trimesh):
        return Mesh(np.zeros((0, 3)), np.zeros((0, 3), np.int32))
    return Mesh(np.asarray(loaded.vertices, np.float64), np.asarray(loaded.faces, np.int32))


def _join(meshes: list[Mesh]) -> Mesh:
    offset = np.cumsum([0] + [len(m.vertices) for m in meshes])
    return Mesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.faces + o for m, o in zip(meshes, offset, strict=False)]).astype(
            np.int32
        ),
    )
