"""MJCF files as a data set, read through MuJoCo itself.

MuJoCo resolves includes, defaults and frames; what it compiled is taken at its reference pose, in
the world frame (+z up, metres). Geoms that collide with nothing are what is seen; where there is
none, all geoms count.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.datasets.merging import merge_rigid
from model.datasets.protocol import GroundTruth
from model.errors import ConfigurationError, InputFileError
from model.geometry.mesh import Material, Mesh
from model.installing import install_command
from model.kinematics.articulated_object import Part
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from model.kinematics.urdf_meshes import merged, moved_mesh

LEAST_MASS = 1e-6
"""kg: MuJoCo refuses moving bodies without mass, which matters only once they are simulated."""
FULL_TURN = 2 * math.pi - 1e-6


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
        _mujoco()
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
        return read_mjcf(path, object_id)


def read_mjcf(path: Path, name: str | None = None) -> GroundTruth:
    """Read one MJCF file: bodies are links, hinges and slides joints.

    A body with several joints becomes a chain with helper links. Free joints leave their body
    where it stands; a ball is three turns of ±pi.

    Raises:
        InputFileError: where MuJoCo can't load it, or nothing in it can be seen.
    """
    model, data = _compiled(path)
    links = ["world", *_body_names(model)]
    joints, notes = _joints(model, data, links)
    parts = _parts(model, data, links)
    if not parts:
        raise InputFileError(path, "no body has a geom that can be seen")
    tree = KinematicTree(tuple([*links, *_helpers(joints, links)]), tuple(joints))
    object_id = name or path.stem
    obj, merges = merge_rigid(object_id, tree, parts)
    return GroundTruth(object_id, obj, (*notes, *merges))


def _mujoco() -> Any:
    if find_spec("mujoco") is None:
        raise ConfigurationError(
            "MJCF is read through MuJoCo, which isn't installed; "
            f"{install_command('artiworld[physics]')}"
        )
    return import_module("mujoco")


def _compiled(path: Path) -> tuple[Any, Any]:
    mujoco = _mujoco()
    try:
        spec = mujoco.MjSpec.from_file(str(path))
        spec.compiler.boundmass = max(spec.compiler.boundmass, LEAST_MASS)
        spec.compiler.boundinertia = max(spec.compiler.boundinertia, LEAST_MASS**1.5)
        model = spec.compile()
    except (ValueError, OSError) as error:
        raise InputFileError(
            path, f"MuJoCo can't load it: {' '.join(str(error).split())}"
        ) from None
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def _body_names(model: Any) -> Iterator[str]:
    """Unique names of all bodies but the world."""
    taken = {"world"}
    for i in range(1, model.nbody):
        name = model.body(i).name or f"body_{i}"
        while name in taken:
            name += "_"
        taken.add(name)
        yield name


def _joints(model: Any, data: Any, links: list[str]) -> tuple[list[Joint], list[str]]:
    out: list[Joint] = []
    notes: list[str] = []
    taken: set[str] = set()
    for body in range(1, model.nbody):
        child, above = links[body], links[model.body_parentid[body]]
        first, count = model.body_jntadr[body], model.body_jntnum[body]
        motions = [m for j in range(first, first + count) for m in _motions(model, data, j, notes)]
        for i, (name, kind, axis, origin, limits) in enumerate(motions):
            below = child if i == len(motions) - 1 else f"helper_{child}_{i}"
            unique = name if name not in taken else f"{name}_{body}_{i}"
            taken.add(unique)
            out.append(Joint(unique, kind, above, below, axis, origin, *limits))
            above = below
        if not motions:
            out.append(Joint(f"fixed_{body}", "fixed", above, child))
    return out, notes


def _motions(model: Any, data: Any, j: int, notes: list[str]) -> list[Any]:
    """Name, type, axis, origin and limits of what MuJoCo's joint ``j`` does, world frame."""
    kind = int(model.jnt_type[j])  # 0 free, 1 ball, 2 slide, 3 hinge
    name = model.joint(j).name or f"joint_{j}"
    if kind == 0:
        notes.append(f"joint {name!r} is free: the body stays where it stands")
        return []
    origin = tuple(float(v) for v in data.xanchor[j])
    if kind == 1:
        notes.append(f"joint {name!r} is a ball: read as three turns")
        limits = (-math.pi, math.pi)
        return [(f"{name}_{a}", "revolute", tuple(np.eye(3)[a]), origin, limits) for a in range(3)]
    axis = tuple(float(v) for v in data.xaxis[j])
    reference = float(model.qpos0[model.jnt_qposadr[j]])
    low, high = (float(v) - reference for v in model.jnt_range[j])
    if kind == 3:
        if not model.jnt_limited[j] or high - low >= FULL_TURN:
            return [(name, "continuous", axis, origin, (None, None))]
        return [(name, "revolute", axis, origin, (low, high))]
    if not model.jnt_limited[j]:
        notes.append(f"joint {name!r} slides without limits: its range is taken as 0")
        low = high = 0.0
    return [(name, "prismatic", axis, origin, (low, high))]


def _helpers(joints: list[Joint], links: list[str]) -> list[str]:
    known = set(links)
    return [j.child for j in joints if j.child not in known]


def _parts(model: Any, data: Any, links: list[str]) -> dict[str, Part]:
    seen = np.flatnonzero((model.geom_contype == 0) & (model.geom_conaffinity == 0))
    chosen = seen if len(seen) else np.arange(model.ngeom)
    meshes: dict[str, list[Mesh]] = {}
    for g in chosen:
        mesh = _geom_mesh(model, int(g))
        if mesh is None:
            continue
        world_from_geom = np.eye(4)
        world_from_geom[:3, :3] = data.geom_xmat[g].reshape(3, 3)
        world_from_geom[:3, 3] = data.geom_xpos[g]
        link = links[model.geom_bodyid[g]]
        meshes.setdefault(link, []).append(moved_mesh(mesh, world_from_geom))
    return {link: Part(link, merged(own)) for link, own in meshes.items()}


def _geom_mesh(model: Any, g: int) -> Mesh | None:
    """A geom's triangles in its own frame; None for planes, height fields and the like."""
    from trimesh import creation

    rgba, metallic, roughness = model.geom_rgba[g], None, None
    look = int(model.geom_matid[g])
    if look >= 0:
        rgba = model.mat_rgba[look]
        metallic, roughness = (  # -1 is MuJoCo's for what isn't said
            None if value < 0 else min(float(value), 1.0)
            for value in (model.mat_metallic[look], model.mat_roughness[look])
        )
    color = tuple(int(v) for v in np.clip(np.round(255 * rgba), 0, 255))
    kind, (a, b, c) = int(model.geom_type[g]), (float(v) for v in model.geom_size[g])
    if kind == 7:
        vertices, faces = _mesh_arrays(model, int(model.geom_dataid[g]))
    else:
        if kind == 2:
            made = creation.icosphere(subdivisions=3, radius=a)
        elif kind == 3:
            made = creation.capsule(height=2 * b, radius=a)
            made.apply_translation((0, 0, -made.bounds.mean(axis=0)[2]))
        elif kind == 4:
            made = creation.icosphere(subdivisions=3)
            made.apply_scale((a, b, c))
        elif kind == 5:
            made = creation.cylinder(height=2 * b, radius=a)
        elif kind == 6:
            made = creation.box(extents=(2 * a, 2 * b, 2 * c))
        else:
            return None
        vertices, faces = np.asarray(made.vertices), np.asarray(made.faces)
    material = Material("mjcf", color, None, metallic, roughness)  # type: ignore[arg-type]
    return Mesh(vertices, faces.astype(np.int32), materials=(material,))


def _mesh_arrays(model: Any, mesh: int) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.int32]]:
    v, f = model.mesh_vertadr[mesh], model.mesh_faceadr[mesh]
    vertices = model.mesh_vert[v : v + model.mesh_vertnum[mesh]].astype(np.float64)
    return vertices, model.mesh_face[f : f + model.mesh_facenum[mesh]].astype(np.int32)
