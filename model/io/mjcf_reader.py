"""Read MJCF through MuJoCo into the same model as URDF; ``mjcf_source`` prepares the text.

Bodies are links, all in the world frame (+z up, metres) at the model's reference pose.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import Inertial, inertial_problems
from model.core.errors import InputFileError
from model.core.files import free_name
from model.core.geometry import Mesh, affine
from model.core.joint import DeclaredDynamics, Joint, Mimic
from model.core.packages import require
from model.io.formats.loaded import DEFAULT_MAX_BYTES
from model.io.geometry_files import SUFFIXES
from model.io.mjcf_source import MjcfSource, read_source, sites_of
from model.io.urdf.files import package_root
from model.io.urdf.meshes import (
    DeclaredCollision,
    Looks,
    UrdfVisual,
    compiled_mesh,
    ellipsoid,
    repeats,
)
from model.io.urdf.model import DeclaredPhysics, UrdfModel, model_from

LEAST_MASS = 1e-6
"""kg: MuJoCo refuses moving bodies without mass, which matters only once they are simulated."""
LARGEST = 1e6
"""Metres of a size, an offset or a limit; as for a URDF."""
WATER = 1000.0
"""kg/m³: what MuJoCo takes geoms for of which nothing is said."""
SEEN_GROUPS = 2
"""MuJoCo shows geoms of groups up to this one."""
_WORLD = "world"
_FREE, _BALL, _HINGE = 0, 1, 3  # mjtJoint
_PLANE, _FIELD, _SPHERE, _CAPSULE, _ELLIPSOID, _CYLINDER, _BOX, _MESH = range(8)  # mjtGeom

FloatArray = npt.NDArray[np.float64]


def read_mjcf_model(
    path: str | Path, *, root: str | Path | None = None, max_bytes: int = DEFAULT_MAX_BYTES
) -> UrdfModel:
    """Read an MJCF as a URDF is read.

    - A body with several joints becomes a chain with helper links. Free joints leave their body
      where it stands, a ball is three turns of ±pi, a slide without limits doesn't move; ``notes``
      says so.
    - Seen are geoms of the groups 0 to 2: of a body that has some which collide with nothing, these
      and what is in their groups. Felt are geoms that collide with something.
    - Planes and height fields are left out.
    - Masses count as declared where the file gives a body's or its geoms'.
    - The world is a link only where it carries something, or a joint.

    Args:
        path: the file.
        root: the folder that references must not leave; by default as for a URDF.
        max_bytes: refuse larger meshes.

    Raises:
        InputFileError: naming the file and what is wrong in it.
        ConfigurationError: where MuJoCo isn't installed.
    """
    path = Path(path)
    mujoco = need_mujoco()
    source = read_source(path, Path(root) if root is not None else package_root(path), max_bytes)
    return _Reader(path, source, mujoco).read()


def need_mujoco() -> Any:
    """The module.

    Raises:
        ConfigurationError: where it isn't installed.
    """
    return require("mujoco", "artiworld[physics]", "MJCF")


class _Reader:
    def __init__(self, path: Path, source: MjcfSource, mujoco: Any) -> None:
        self.path, self.source = path, source
        self.notes = list(source.notes)
        self.spec, self.model, self.data = self._compiled(mujoco)
        self.links = [_WORLD, *_body_names(self.model)]
        self._check()
        self.looks = Looks(self.model, source.textures, self.notes)
        self.pieces: dict[int, UrdfVisual | None] = {}
        self.meshes: dict[int, Mesh] = {}

    def read(self) -> UrdfModel:
        joints = self._joints()
        dynamics = {j.name: j.dynamics for j in joints if j.dynamics is not None}
        joints = [replace(j, dynamics=None) for j in joints]
        visuals = tuple(v for g in self._seen() if (v := self._piece(g)) is not None)
        if not visuals:
            what = "no body has a geom that can be seen"
            raise InputFileError(self.path, what, "planes and height fields are none")
        felt = self._felt()
        links = [*self.links, *(j.child for j in joints if j.child not in set(self.links))]
        links, joints = self._without_world(links, joints, {v.link for v in visuals} | set(felt))
        mimics = self._mimics(joints)
        collision = {
            link: DeclaredCollision(held, "", repeats(held, [v for v in visuals if v.link == link]))
            for link, held in felt.items()
        }
        affordances = tuple(sites_of(self.model, self.links))
        return model_from(
            self.path,
            self.source.name,
            links,
            [replace(j, mimic=mimics.get(j.name)) for j in joints],
            visuals,
            self.notes,
            DeclaredPhysics(self._inertials(), dynamics, (), collision, affordances),
            files=(*self.source.files, *dict.fromkeys(self.looks.used)),
            part_names=self.source.part_names,
        )

    def _compiled(self, mujoco: Any) -> tuple[Any, Any, Any]:
        try:
            if self.source.flat:
                self._check_flat(mujoco)
            spec = mujoco.MjSpec.from_string(self.source.text, assets=self.source.assets)
            spec.compiler.boundmass = max(spec.compiler.boundmass, LEAST_MASS)
            spec.compiler.boundinertia = max(spec.compiler.boundinertia, LEAST_MASS**1.5)
            model = spec.compile()
        except (ValueError, OSError) as error:
            # Line numbers are those of the prepared text, not of the file.
            said = re.sub(r",? line \d+", "", " ".join(str(error).split()))
            raise InputFileError(self.path, f"MuJoCo can't load it: {said}") from None
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        return spec, model, data

    def _check_flat(self, mujoco: Any) -> None:
        """Let MuJoCo compare what frames hold with its schema.

        Raises:
            ValueError: for elements and attributes that it doesn't know.
        """
        try:
            mujoco.MjSpec.from_string(self.source.flat, assets=self.source.assets)
        except ValueError as error:
            if "Schema violation" in str(error):
                raise

    def _check(self) -> None:
        """Refuse values so large or small that sums overflow or vanish."""
        model, data = self.model, self.data
        solid = model.geom_type > _FIELD
        for what, values, owner in (
            ("body", data.xpos, np.arange(model.nbody)),
            ("geom", data.geom_xpos, model.geom_bodyid),
            ("geom", model.geom_size * solid[:, None], model.geom_bodyid),
            ("joint", data.xanchor, model.jnt_bodyid),
            ("joint", model.jnt_range * (model.jnt_limited != 0)[:, None], model.jnt_bodyid),
        ):
            wrong = ~(np.abs(values) <= LARGEST).all(axis=1)
            if wrong.any():
                link = self.links[int(owner[np.flatnonzero(wrong)[0]])]
                where = f"body {link!r}" if what == "body" else f"a {what} of body {link!r}"
                far = f"{where} is larger or farther off than can be"
                raise InputFileError(self.path, far, f"{LARGEST:g} m is the most")

    # -- joints ----------------------------------------------------------------------------------

    def _joints(self) -> list[Joint]:
        model, out = self.model, list[Joint]()
        names = {model.joint(j).name for j in range(model.njnt)} - {""}
        for body in range(1, model.nbody):
            child, above = self.links[body], self.links[model.body_parentid[body]]
            first, count = int(model.body_jntadr[body]), int(model.body_jntnum[body])
            motions = [m for j in range(first, first + count) for m in self._motions(j, names)]
            if not motions:
                motions = [Joint(free_name(f"fixed_{child}", names), "fixed", "", child)]
                names.add(motions[0].name)
            for i, motion in enumerate(motions, 1):
                last = i == len(motions)
                below = child if last else free_name(f"helper_{child}_{i - 1}", self.links)
                out.append(replace(motion, parent=above, child=below))
                above = below
        return out

    def _motions(self, j: int, names: set[str]) -> list[Joint]:
        """Motions of one MuJoCo joint, world frame, one after the other; their links are open."""
        model, data, kind = self.model, self.data, int(self.model.jnt_type[j])
        name = model.joint(j).name
        if not name:
            name = free_name(f"joint_{j}", names)
            names.add(name)
        if kind == _FREE:
            if model.nbody > 2 and int((model.body_parentid[1:] == 0).sum()) > 1:
                body = self.links[model.jnt_bodyid[j]]
                self.notes.append(f"body {body!r} is free: it stays where it stands")
            return []
        origin = tuple(data.xanchor[j].tolist())
        if model.jnt_stiffness[j] != 0:
            self.notes.append(f"joint {name!r} has a spring, which is not kept")
        dof = int(model.jnt_dofadr[j])
        if model.dof_dampingpoly[dof].any() or model.dof_damping[dof] < 0:
            self.notes.append(f"joint {name!r}: damping is read where it is linear and above 0")
        base = Joint(name, "continuous", "", "to", origin=origin, dynamics=self._dynamics(j))
        if kind == _BALL:
            self.notes.append(f"joint {name!r} is a ball: read as three turns")
            turn = replace(base, type="revolute", lower=-math.pi, upper=math.pi)
            axes = zip("xyz", np.eye(3).tolist(), strict=True)
            return [replace(turn, name=free_name(f"{name}_{w}", names), axis=a) for w, a in axes]
        base = replace(base, axis=tuple(data.xaxis[j].tolist()))
        reference = float(model.qpos0[model.jnt_qposadr[j]])
        low, high = (float(v) - reference for v in model.jnt_range[j])
        limited = bool(model.jnt_limited[j])
        if not limited and low > high:
            self.notes.append(
                f"joint {name!r}: limits {low:g}..{high:g} are in the wrong order: taken for none"
            )
        if kind == _HINGE:
            return [replace(base, type="revolute", lower=low, upper=high) if limited else base]
        if not limited:
            self.notes.append(f"joint {name!r} slides without limits: its range is taken as 0")
            low = high = 0.0
        return [replace(base, type="prismatic", lower=low, upper=high)]

    def _mimics(self, joints: Sequence[Joint]) -> dict[str, Mimic]:
        moving = {j.name: j for j in joints if j.moves}
        out: dict[str, Mimic] = {}
        for follower, (leader, terms) in self.source.couplings.items():
            if not {follower, leader} <= moving.keys():
                self.notes.append(f"joint {follower!r} follows {leader!r}, which is not kept")
                continue
            if any(terms[2:]):
                what = f"joint {follower!r} follows {leader!r} along a curve"
                self.notes.append(f"{what}: read as a straight line over the leader's range")
            out[follower] = Mimic(leader, *_line(terms, moving[leader]))
        return out

    def _dynamics(self, j: int) -> DeclaredDynamics | None:
        """Zeros are MuJoCo's defaults and count as undeclared."""
        model, dof = self.model, int(self.model.jnt_dofadr[j])
        damping, friction = float(model.dof_damping[dof]), float(model.dof_frictionloss[dof])
        effort = None
        if model.jnt_actfrclimited[j]:
            effort = float(np.abs(model.jnt_actfrcrange[j]).max()) or None
        if damping <= 0 and friction <= 0 and effort is None:
            return None
        said = damping > 0 or friction > 0
        return DeclaredDynamics(
            max(damping, 0.0) if said else None, max(friction, 0.0) if said else None, effort
        )

    def _without_world(
        self, links: list[str], joints: list[Joint], holding: set[str]
    ) -> tuple[list[str], list[Joint]]:
        below = [j for j in joints if j.parent == _WORLD]
        if _WORLD in holding or len(below) != 1 or below[0].moves:
            return links, joints
        return [n for n in links if n != _WORLD], [j for j in joints if j is not below[0]]

    # -- geometry --------------------------------------------------------------------------------

    def _seen(self) -> Sequence[int]:
        model = self.model
        groups, bodies = model.geom_group, model.geom_bodyid
        shown = (groups <= SEEN_GROUPS) & (self._alphas() > 0) & (model.geom_type > _FIELD)
        bare = shown & (model.geom_contype == 0) & (model.geom_conaffinity == 0)
        looked_at = np.isin(bodies, bodies[bare])  # of bodies with geoms made for looking at
        same = np.isin(groups, groups[bare])
        out = np.flatnonzero(shown & (~looked_at | same))
        if len(out):
            return out.tolist()
        self.notes.append("no geom is shown; all were taken")
        return range(model.ngeom)

    def _alphas(self) -> FloatArray:
        model = self.model
        out = model.geom_rgba[:, 3].astype(np.float64)
        own = model.geom_matid >= 0
        out[own] = model.mat_rgba[model.geom_matid[own], 3]
        return out

    def _felt(self) -> dict[str, tuple[UrdfVisual, ...]]:
        out: dict[str, tuple[UrdfVisual, ...]] = {}
        for g in np.flatnonzero(
            (self.model.geom_contype != 0) | (self.model.geom_conaffinity != 0)
        ):
            piece = self._piece(int(g))
            if piece is not None:
                out[piece.link] = (*out.get(piece.link, ()), piece)
        return out

    def _piece(self, g: int) -> UrdfVisual | None:
        if g not in self.pieces:
            self.pieces[g] = self._made(g)
        return self.pieces[g]

    def _made(self, g: int) -> UrdfVisual | None:
        """A geom in the world frame; None if it has no triangles."""
        model, data = self.model, self.data
        kind = int(model.geom_type[g])
        link = self.links[model.geom_bodyid[g]]
        pose = affine(data.geom_xmat[g].reshape(3, 3), data.geom_xpos[g])
        if kind <= _FIELD or kind > _MESH:
            what = {_PLANE: "a plane", _FIELD: "a height field"}.get(kind, "of an unknown kind")
            self.notes.append(f"a geom of body {link!r} is {what}; it was left out")
            return None
        material = self.looks.of(g)
        if kind == _MESH:
            made = self._of_mesh(int(model.geom_dataid[g]), link, pose, material)
            return replace(made, repeat=self.looks.repeat(g))
        a, b, c = model.geom_size[g].tolist()
        if kind == _ELLIPSOID:
            mesh = ellipsoid((a, b, c))
            return UrdfVisual(link, None, pose, mesh=mesh, material=material)
        shape: tuple[str, tuple[float, ...]] = {
            _SPHERE: ("sphere", (a,)),
            _CAPSULE: ("capsule", (a, 2 * b)),
            _CYLINDER: ("cylinder", (a, 2 * b)),
            _BOX: ("box", (2 * a, 2 * b, 2 * c)),
        }[kind]
        return UrdfVisual(link, None, pose, primitive=shape, material=material)

    def _of_mesh(self, number: int, link: str, pose: FloatArray, material: Any) -> UrdfVisual:
        model, name = self.model, self.model.mesh(number).name
        file = self.source.meshes.get(name)
        if file is None or file.suffix.lower() not in SUFFIXES:
            if number not in self.meshes:
                self.meshes[number] = compiled_mesh(model, number)
            mesh = self.meshes[number]
            return UrdfVisual(link, None, pose, mesh=mesh, material=material)
        # MuJoCo has moved the mesh to its own centre of mass and main axes.
        said = self.spec.mesh(name)
        quaternions = np.roll([model.mesh_quat[number], said.refquat], -1, axis=1)
        turns = Rotation.from_quat(quaternions).as_matrix()
        middle = affine(turns[0], model.mesh_pos[number])
        shift = affine(shift=-np.asarray(said.refpos))
        turn = affine(turns[1].T)
        scale = np.diag([*np.asarray(said.scale, np.float64), 1.0])
        whole = pose @ np.linalg.inv(middle) @ scale @ turn @ shift
        return UrdfVisual(link, None, whole, file, material=material)

    # -- masses ----------------------------------------------------------------------------------

    def _inertials(self) -> dict[str, Inertial]:
        """Inertials of bodies whose mass the file declares."""
        model, data = self.model, self.data
        for body in self.spec.bodies:
            if body.explicitinertial and body.mass < 0:
                name = self.links[body.id]
                self.notes.append(f"body {name!r}: no body has a mass below 0; it was left out")
        said = {b.id for b in self.spec.bodies if b.explicitinertial} | {
            g.parent.id
            for g in self.spec.geoms
            if (math.isfinite(g.mass) and g.mass > 0)
            or (math.isnan(g.mass) and g.density not in (0, WATER))
        }
        if self.spec.compiler.settotalmass > 0:
            said = set(range(model.nbody))
        out: dict[str, Inertial] = {}
        for body in sorted(said - {0}):
            if model.body_mass[body] <= LEAST_MASS:
                continue
            turn = data.ximat[body].reshape(3, 3)
            own = Inertial(
                float(model.body_mass[body]),
                data.xipos[body].astype(np.float64),
                turn @ np.diag(model.body_inertia[body]) @ turn.T,
            )
            if not inertial_problems({"": own}):
                out[self.links[body]] = own
        return out


def _line(terms: Sequence[float], leader: Joint) -> tuple[float, float]:
    """Slope and offset of a polynomial; of a curve its chord from rest to the leader's far end."""
    low, high = leader.motion_range
    start = min(max(0.0, low), high)
    end = max(low, high, key=lambda q: abs(q - start))
    if not any(terms[2:]) or start == end:
        offset, slope = [*terms, 0.0, 0.0][:2]
        return slope, offset
    values = np.polynomial.polynomial.polyval([start, end], terms)
    slope = float(values[1] - values[0]) / (end - start)
    return slope, float(values[0]) - slope * start


def _body_names(model: Any) -> Iterator[str]:
    """Unique names of all bodies but the world."""
    taken = {_WORLD} | {model.body(i).name for i in range(1, model.nbody)}
    for i in range(1, model.nbody):
        yield model.body(i).name or free_name(f"body_{i}", taken)
