"""Read the articulation of a USD stage (UsdPhysics) into the same model as a URDF.

Rigid bodies are links, in the stage's world frame turned to +z up, metres, as they stand. What no
body holds belongs to the link ``world``. Conventions of joints are those of the schema: body 1
moves against body 0, revolute limits are degrees, and lengths are in the stage's unit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import Affordance, Inertial, inertial_problems
from model.core.composite_joints import Composite, composite_joints, free_helpers
from model.core.errors import GeometryError, InputFileError, KinematicsError
from model.core.files import free_name
from model.core.geometry import affine, uniform_scale
from model.core.joint import JOINT_KINDS, JOINT_TYPES, DeclaredDynamics, Joint, JointType, Mimic
from model.core.packages import require
from model.core.tree import KinematicTree
from model.io.export.usd import AFFORDANCE, FRICTION, NAME_KEY
from model.io.formats.loaded import DEFAULT_MAX_BYTES
from model.io.formats.usd import UsdStage, sound_stage
from model.io.geometry_files import cleaned, to_mesh
from model.io.urdf.meshes import DeclaredCollision, UrdfVisual
from model.io.urdf.model import DeclaredPhysics, UrdfModel, renamed_helpers
from model.io.urdf.sdf import UNLIMITED
from model.physics.inertia import hull_inertial

WORLD = "world"
MOST_BODIES = 5000
"""More are no object; as for a URDF's links."""
WIDE = 10.0
"""Metres both ways; what is static and wider is no object's."""
APART = 1e-3
"""Difference of two joint frames in metres, beside the joint's own motion, that is remarked."""
_TYPES: dict[str, JointType] = {
    **{JOINT_KINDS[kind].usd: kind for kind in JOINT_TYPES if kind != "continuous"},
    "PhysicsSphericalJoint": "revolute",
}
_LABEL = "semantics:labels:class"

FloatArray = npt.NDArray[np.float64]


def read_usd_model(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> UrdfModel | None:
    """The articulation of a stage; None where no joint moves, or joints hold several objects.

    - Each link has one way to the root: the world where a joint fixes a body to it, else the body
      that no joint moves. Joints that close a loop are left out, with a remark.
    - Spherical joints become three turns; joints of other kinds are fixed, with a remark.
    - Bodies without a joint stand where they are.

    Raises:
        InputFileError: where it is no stage, or what it holds is inconsistent.
        ConfigurationError: where usd-core isn't installed.
    """
    with sound_stage(path):
        return _Reader(path, max_bytes).read()


@dataclass(frozen=True)
class _Link:
    """A joint as written: between two links, with its frames in the world.

    Attributes:
        prim: the joint. zero, one: the links that it joins.
        type: of the joint.
        frame: (4, 4) joint frame on body 0, turned so that the axis is x.
        value: where it stands, rad or m. unit: rad or m of a value as written.
    """

    prim: Any
    zero: str
    one: str
    type: JointType
    frame: FloatArray
    value: float
    unit: float


class _Reader:
    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path, self.stage = path, UsdStage(path, max_bytes)
        self.physics: Any = require("pxr.UsdPhysics", "artiworld[usd]", "USD")
        self.get = self.stage.get
        self.notes: list[str] = []
        self.link_of: dict[Any, str] = {}  # path of a body's prim → its link
        self.taken = {WORLD}
        self.joint_names: set[str] = set()
        self.static: dict[str, str] = {}  # path → name of prims without a body that joints name
        self.kilograms = float(self.physics.GetStageKilogramsPerUnit(self.stage.stage) or 1.0)

    def read(self) -> UrdfModel | None:
        prims = [p for p, _ in self.stage.walk()]
        bodies = [p for p in prims if self.stage.is_body(p)]
        if len(bodies) > MOST_BODIES:
            raise InputFileError(self.path, f"has {len(bodies)} bodies", "cut the stage")
        for body in bodies:
            self.link_of[body.GetPath()] = self._name(body, self.taken)
        written = (self._joint(p) for p in prims if p.IsA(self.physics.Joint))
        joined = [j for j in written if j is not None]
        if not any(j.type != "fixed" for j in joined) or self._several(joined):
            return None
        visuals = tuple(self._shapes(self.stage.prims(), seen=True))
        if not visuals:
            raise InputFileError(self.path, "no body has a mesh that can be seen", "add one")
        self.notes += self.stage.unread(self.stage.prims())
        return self._model(bodies, joined, visuals)

    def _name(self, prim: Any, taken: set[str]) -> str:
        said = prim.GetCustomDataByKey(NAME_KEY)
        name = free_name(said if isinstance(said, str) and said else str(prim.GetName()), taken)
        taken.add(name)
        return name

    def _several(self, joints: list[_Link]) -> bool:
        """True if joints that move hold more than one group of bodies: a scene of objects. One
        static prim that joints name is a body, too."""
        group: dict[str, str] = {}

        def top(link: str) -> str:
            while link in group:
                link = group[link]
            return link

        for joint in joints:
            apart = top(joint.one) != top(joint.zero)
            if apart and (WORLD not in (joint.zero, joint.one) or len(self.static) == 1):
                group[top(joint.one)] = top(joint.zero)
        moved = (j.zero if j.one == WORLD else j.one for j in joints if j.type != "fixed")
        return len(set(map(top, moved))) > 1

    # Geometry

    def _holder(self, prim: Any) -> str:
        body = self.stage.body_of(prim)
        return self.link_of[body.GetPath()] if body else WORLD

    def _shapes(self, prims: Any, *, seen: bool) -> Iterator[UrdfVisual]:
        """Without names: parts are called after their bodies."""
        for prim in prims:
            felt = prim.HasAPI(self.physics.CollisionAPI)
            if not seen and not (felt and self.get(prim, "physics:collisionEnabled") is not False):
                continue
            made, link = self.stage.shape_of(prim), self._holder(prim)
            if made is None:
                continue
            world = made.moved(self.stage.world(prim) @ self.stage.into)
            mesh = to_mesh(cleaned(self.path, world, np.eye(4), 1.0))
            size = np.ptp(mesh.bounds, axis=0)
            if link == WORLD and size[:2].min() > WIDE:
                extent = f"{size[0]:.3g} x {size[1]:.3g} m: taken for a ground, left out"
                self.notes.append(f"{prim.GetName()} is {extent}")
                continue
            yield UrdfVisual(link, None, np.eye(4), mesh=mesh)

    # Joints

    def _joint(self, prim: Any) -> _Link | None:
        """One joint, with both its frames; None for one that is off, or joins nothing: remarked."""
        said, kind = f"joint {str(prim.GetName())!r}", str(prim.GetTypeName())
        (zero, at_zero), (one, at_one) = (
            self._end(prim.GetRelationship(f"physics:body{k}")) for k in (0, 1)
        )
        off = self.get(prim, "physics:jointEnabled") is False
        if off or zero == one:
            self.notes.append(f"{said} {'is switched off' if off else 'joins nothing'}: left out")
            return None
        type_ = _TYPES.get(kind, "fixed")
        if kind not in _TYPES:
            self.notes.append(f"{said} of type {kind}: read as fixed")
        axis = "X" if type_ == "fixed" else str(self.get(prim, "physics:axis") or "X")
        onto = affine(np.eye(3)[:, {"X": [0, 1, 2], "Y": [1, 2, 0], "Z": [2, 0, 1]}[axis]])
        zeros, ones = (
            self._frame(at, *(self.get(prim, f"physics:local{n}{k}") for n in ("Pos", "Rot")))
            @ onto
            for k, at in enumerate((at_zero, at_one))
        )
        value = self._value(said, type_, np.linalg.inv(zeros) @ ones)
        unit = math.pi / 180 if type_ == "revolute" else self.stage.unit
        return _Link(prim, zero, one, type_, zeros, value, unit)

    def _end(self, relation: Any) -> tuple[str, FloatArray]:
        """The link that a joint's end lies on, and (4, 4) of the prim that it names."""
        targets = relation.GetForwardedTargets()
        prim = self.stage.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not prim:
            what = f"a joint names {targets[0]}, which isn't on the stage"
            raise InputFileError(self.path, what, "export it again")
        if prim is None or prim.IsPseudoRoot():
            return WORLD, self.stage.turn @ np.eye(4)
        if self.stage.body_of(prim) is None:
            self.static[str(targets[0])] = str(prim.GetName())
        return self._holder(prim), self.stage.world(prim) @ self.stage.turn

    def _frame(self, world: FloatArray, place: Any, turn: Any) -> FloatArray:
        """(4, 4) rigid frame in metres, +z up, of a place and a turn in a prim's own frame."""
        scaled = world[:3, :3]
        rotation = scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-12)
        rotation *= 1.0 if np.linalg.det(rotation) >= 0 else -1.0
        local = [0.0] if turn is None else [*turn.GetImaginary(), turn.GetReal()]
        if np.linalg.norm(local) > 1e-9:
            rotation = rotation @ Rotation.from_quat(local).as_matrix()
        return affine(
            rotation, scaled @ (np.asarray(place or (0, 0, 0)) * self.stage.unit) + world[:3, 3]
        )

    def _value(self, said: str, type_: JointType, apart: FloatArray) -> float:
        """Present joint value; adds a remark where the joint's frames differ by anything else."""
        shift, turn = apart[:3, 3].copy(), Rotation.from_matrix(apart[:3, :3]).as_rotvec()
        value = turn[0] if JOINT_KINDS[type_].rotates else 0.0
        if JOINT_KINDS[type_].slides:
            value, shift[0] = shift[0], 0.0
        away = np.linalg.norm(shift)
        if type_ != "fixed" and away > APART:
            self.notes.append(f"{said}: its frames stand {away:.3g} m apart; that of body 0 counts")
        return 0.0 if abs(value) < 1e-6 else float(value)

    # The model

    def _model(
        self, bodies: list[Any], joined: list[_Link], visuals: tuple[UrdfVisual, ...]
    ) -> UrdfModel:
        links = list(self.link_of.values())
        if any(v.link == WORLD for v in visuals) or any(WORLD in (j.zero, j.one) for j in joined):
            links.insert(0, WORLD)
        joints, written = self._tree(links, joined)
        joints = [one for j in joints for one in self._ball(j, written, links)]
        holding = {v.link for v in visuals}
        if links[0] == WORLD and WORLD not in holding:
            below = [j for j in joints if j.parent == WORLD]
            if len(below) == 1 and not below[0].moves:
                links, joints = links[1:], [j for j in joints if j is not below[0]]
        renotes: list[str] = []
        renamed = renamed_helpers(links, holding, renotes)
        mimics = self._mimics(written)
        joints = [replace(j, mimic=mimics.get(j.name)) for j in joints]
        try:
            tree = KinematicTree(tuple(links), tuple(joints)).renamed(renamed)
        except KinematicsError as error:
            raise InputFileError(self.path, str(error)) from None
        felt: dict[str, list[UrdfVisual]] = {}
        for shape in self._shapes([p for p, _ in self.stage.walk()], seen=False):
            felt.setdefault(renamed.get(shape.link, shape.link), []).append(shape)
        moving = {j.name: written[j.name] for j in joints if j.moves and j.name in written}
        said = ((n, self._dynamics(link)) for n, link in moving.items())
        declared = DeclaredPhysics(
            {renamed.get(link, link): i for link, i in self._inertials(bodies, visuals)},
            {n: d for n, d in said if d is not None},
            (),
            {link: DeclaredCollision(tuple(held)) for link, held in felt.items()},
            tuple(self._affordances(tree)),
        )
        labels = {renamed.get(link, link): text for link, text in self._labels(bodies)}
        top = self.stage.stage.GetDefaultPrim()
        return UrdfModel(
            self.path,
            str(top.GetName()) if top else self.path.stem,
            tree,
            visuals,
            tuple(dict.fromkeys([*self.notes, *renotes])),
            renamed=tuple(renotes),
            declared=declared,
            part_names=labels,
            category=_label(top) if top else None,
        )

    def _tree(self, links: list[str], joined: list[_Link]) -> tuple[list[Joint], dict[str, _Link]]:
        """Joints from the root outwards, and what each was written as; of a loop one that is
        excluded from the articulation is left out."""
        moved = {j.one for j in joined}
        first = [WORLD] if links[0] == WORLD else [n for n in links if n not in moved]
        root = next(iter(first), links[0])
        out: list[Joint] = []
        written: dict[str, _Link] = {}
        exclude = "physics:excludeFromArticulation"
        left = sorted(joined, key=lambda j: self.get(j.prim, exclude) is True)
        reached = {root}
        for start in (root, *links):
            if start not in reached:  # stands apart
                name = free_name(f"fixed_{start}", self.joint_names)
                self.joint_names.add(name)
                out.append(Joint(name, "fixed", root, start))
                reached.add(start)
            while near := [j for j in left if j.zero in reached or j.one in reached]:
                joint, ends = near[0], (near[0].zero, near[0].one)
                left.remove(joint)
                if reached.issuperset(ends):
                    said = str(joint.prim.GetName())
                    self.notes.append(f"joint {said!r} closes a loop: left out")
                    continue
                out.append(self._made(joint, *(ends if joint.zero in reached else ends[::-1])))
                written[out[-1].name] = joint
                reached.update(ends)
        return out, written

    def _made(self, joint: _Link, parent: str, child: str) -> Joint:
        name = self._name(joint.prim, self.joint_names)
        if joint.type == "fixed":
            return Joint(name, "fixed", parent, child)
        sign = 1.0 if parent == joint.zero else -1.0
        a, o = (sign * joint.frame[:3, 0]).tolist(), joint.frame[:3, 3].tolist()
        ends = [self.get(joint.prim, f"physics:{n}Limit") for n in ("lower", "upper")]
        low, high = (
            inf if end is None or not abs(end) <= UNLIMITED else end * joint.unit - joint.value
            for end, inf in zip(ends, (-math.inf, math.inf), strict=True)
        )
        type_, known = joint.type, [math.isfinite(low), math.isfinite(high)]
        if type_ == "revolute" and not any(known):
            type_ = "continuous"
        elif low > high or not any(known):
            self.notes.append(f"joint {name!r} has no range: it is taken as 0")
            low = high = 0.0
        elif not all(known):
            whole = 2 * math.pi if type_ == "revolute" else 1.0
            low, high = (low, low + whole) if known[0] else (high - whole, high)
            self.notes.append(f"joint {name!r} has one limit: {whole:.4g} from it is the other")
        return Joint(name, type_, parent, child, (a[0], a[1], a[2]), (o[0], o[1], o[2]), low, high)

    def _ball(self, joint: Joint, written: dict[str, _Link], links: list[str]) -> tuple[Joint, ...]:
        """A spherical joint as three turns; the links between them are added to ``links``."""
        prim = written[joint.name].prim if joint.name in written else None
        if prim is None or str(prim.GetTypeName()) != "PhysicsSphericalJoint":
            return (joint,)
        cone = prim.GetAttribute("physics:coneAngle0Limit").Get()
        swing = math.radians(cone) if cone is not None and 0 <= cone < 90 else math.pi / 2
        helpers = free_helpers(joint.child, 2, links)
        links += helpers
        return composite_joints(Composite("ball"), joint, helpers, swing=swing)

    def _mimics(self, written: dict[str, _Link]) -> dict[str, Mimic]:
        """PhysX: q + gearing * q(leader) + offset = 0; Newton: q = coefficient 1 * q(leader) +
        coefficient 0; both in degrees or the unit."""
        at = {link.prim.GetPath(): name for name, link in written.items()}
        out: dict[str, Mimic] = {}
        for name, link in written.items():
            keys, sign, prim = ("mimicJoint", "mimicCoef1", "mimicCoef0"), 1.0, link.prim
            names = (str(a.GetName()) for a in prim.GetAttributes())
            base = next((n.removesuffix(":gearing") for n in names if n.endswith(":gearing")), "")
            if base:
                keys, sign = ("referenceJoint", "gearing", "offset"), -1.0
            lead, factor, more = (f"{base or 'newton'}:{key}" for key in keys)
            targets = prim.GetRelationship(lead).GetTargets()
            if not (base or targets) or self.get(prim, "newton:mimicEnabled") is False:
                continue
            leader = at.get(targets[0]) if targets else None
            if leader is None or leader == name:
                self.notes.append(f"joint {name!r} follows a joint that isn't there: on its own")
                continue
            theirs, by = written[leader], self.get(prim, factor)
            multiplier = sign * (1.0 if by is None else float(by)) * link.unit / theirs.unit
            # Values are counted from where the joints stand.
            shift = multiplier * theirs.value - link.value
            offset = sign * float(self.get(prim, more) or 0.0) * link.unit
            out[name] = Mimic(leader, multiplier, offset + shift)
        return out

    def _dynamics(self, joint: _Link) -> DeclaredDynamics | None:
        kind = "angular" if joint.type == "revolute" else "linear"
        force = self.kilograms * self.stage.unit ** (2 if kind == "angular" else 1)
        base = f"drive:{kind}:physics"
        values = (
            float(value) * unit if isinstance(value, int | float) and 0 < value < 1e12 else None
            for value, unit in (
                (self.get(joint.prim, f"{base}:damping"), force / joint.unit),
                (self.get(joint.prim, FRICTION), force),
                (self.get(joint.prim, f"{base}:maxForce"), force),
                (self.get(joint.prim, "physxJoint:maxJointVelocity"), joint.unit),
            )
        )
        found = DeclaredDynamics(*values)
        return None if found == DeclaredDynamics() else found

    # Bodies

    def _inertials(
        self, bodies: list[Any], visuals: tuple[UrdfVisual, ...]
    ) -> Iterator[tuple[str, Inertial]]:
        """Link and inertial of bodies that state a mass; the rest by their hull where unsaid."""
        for body in bodies:
            link, api = self.link_of[body.GetPath()], self.physics.MassAPI(body)
            mass = float(api.GetMassAttr().Get() or 0.0) * self.kilograms
            diagonal = np.asarray(api.GetDiagonalInertiaAttr().Get() or (0, 0, 0), np.float64)
            mine = [v.mesh.vertices for v in visuals if v.link == link and v.mesh is not None]
            whole = bool((diagonal > 0).all())
            if not (mass > 0 and (whole or mine)):
                continue  # worked out from the shapes, as simulators do
            solid = hull_inertial(np.concatenate(mine), 1.0) if mine else None
            place = api.GetCenterOfMassAttr().Get()
            known = api.GetCenterOfMassAttr().HasAuthoredValue() and np.isfinite(place).all()
            world, place = self.stage.world(body) @ self.stage.turn, place if known else None
            frame = self._frame(world, place, api.GetPrincipalAxesAttr().Get())
            turn, center = frame[:3, :3], frame[:3, 3]
            tensor = turn @ np.diag(diagonal * self.kilograms * self.stage.unit**2) @ turn.T
            if solid is not None:
                center = center if known else solid.center
                tensor = tensor if whole else solid.tensor * (mass / solid.mass)
            found = Inertial(mass, center, tensor)
            if inertial_problems({link: found}):
                self.notes.append(f"link {link!r}: its inertia is no body's; worked out again")
                continue
            yield link, found

    def _affordances(self, tree: KinematicTree) -> Iterator[Affordance]:
        """Lines that say where a robot takes hold, as our exporter writes them."""
        for prim in self.stage.stage.Traverse():
            kind = prim.GetAttribute(f"{AFFORDANCE}:kind").Get()
            if kind is None:
                continue
            said = {
                k: prim.GetAttribute(f"{AFFORDANCE}:{k}").Get()
                for k in ("joint", "center", "normal", "closing", "width")
            }
            joint = tree.by_name.get(str(said["joint"]))
            if joint is None:
                continue
            matrix = self.stage.world(prim) @ self.stage.into
            try:
                center, *turned = (
                    matrix[:3, :3] @ np.asarray(said[k], np.float64)
                    for k in ("center", "normal", "closing")
                )
                unit = [tuple((v / np.linalg.norm(v)).tolist()) for v in turned]
                width = float(said["width"] or 0.0) * uniform_scale(matrix[:3, :3])
                at = tuple((center + matrix[:3, 3] - np.asarray(joint.origin)).tolist())
                yield Affordance(joint.name, joint.child, str(kind), at, *unit, width)  # type: ignore[arg-type]
            except (GeometryError, TypeError, ValueError) as error:
                self.notes.append(f"{prim.GetName()}: {error}; it is left out")

    def _labels(self, bodies: list[Any]) -> Iterator[tuple[str, str]]:
        yield from ((WORLD, name) for name in self.static.values())
        for body in bodies:
            if (label := _label(body)) is not None:
                yield self.link_of[body.GetPath()], label


def _label(prim: Any) -> str | None:
    """A prim's first class label."""
    attribute = prim.GetAttribute(_LABEL)
    labels = list(attribute.Get() or ()) if attribute else []
    return str(labels[0]).strip() or None if labels else None
