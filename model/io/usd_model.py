"""Read the articulation of a USD stage (UsdPhysics) into the same model as a URDF.

Rigid bodies are links, in the stage's world frame turned to +z up, metres, as they stand. What no
body holds belongs to the link ``world`` if it stands below the prim that holds all that is joined;
the rest is surroundings. Conventions of joints are those of the schema: body 1 moves against body
0, revolute limits are degrees, and lengths are in the stage's unit. A joint without a type is free
along the axes that no limit locks.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import Affordance, Inertial, inertial_problems, together
from model.core.composite_joints import Composite, composite_joints, free_helpers
from model.core.errors import GeometryError, InputFileError
from model.core.files import free_name
from model.core.geometry import Mesh, affine, uniform_scale
from model.core.joint import JOINT_KINDS, JOINT_TYPES, DeclaredDynamics, Joint, JointType, Mimic
from model.core.packages import require
from model.core.shapes import hull_of
from model.io.export.usd import AFFORDANCE, FRICTION, NAME_KEY
from model.io.formats.loaded import DEFAULT_MAX_BYTES
from model.io.formats.usd import MOST, UsdStage, beside, sound_stage
from model.io.geometry_files import cleaned, to_mesh
from model.io.urdf.meshes import DeclaredCollision, UrdfVisual
from model.io.urdf.model import DeclaredPhysics, UrdfModel, model_from
from model.io.urdf.sdf import UNLIMITED
from model.physics.inertia import hull_inertial

WORLD = "world"
MOST_BODIES = 5000
"""More are no object; as for a URDF's links."""
WIDE = 10.0
"""Metres both ways; what is static and wider is no object's."""
APART, ASKEW = 1e-3, 0.1
"""Metres and degrees between two joint frames, beside the joint's own motion, that are remarked."""
DENSITY = 1000.0
"""kg/m³ of shapes without one beside others that have one, as UsdPhysics has it."""
BALL = "PhysicsSphericalJoint"
_TYPES: dict[str, JointType] = {
    **{JOINT_KINDS[kind].usd: kind for kind in JOINT_TYPES if kind != "continuous"},
    BALL: "revolute",
}
_AXES: dict[str, JointType] = {
    f"{kind}{axis}": _TYPES[f"Physics{name}Joint"]
    for kind, name in (("trans", "Prismatic"), ("rot", "Revolute"))
    for axis in "XYZ"
}
_FOLLOWS = {"newton:mimicJoint": "newton:mimicCoef", "mjc:target": "mjc:coef"}
"""Relation that names the joint to follow, and the start of offset (0) and factor (1)."""
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
        home: path of the static prim that it names, or None.
        type: of the joint. drive: of its motor, such as ``angular``.
        limits: as written.
        frame: (4, 4) joint frame on body 0, turned so that the axis is x.
        value: where it stands, rad or m. unit: rad or m of a value as written.
    """

    prim: Any
    zero: str
    one: str
    home: Any
    type: JointType
    drive: str
    limits: tuple[Any, ...]
    frame: FloatArray
    value: float
    unit: float


class _Piece(NamedTuple):
    """A shape: the link that holds it, if it is seen, and if it is felt."""

    prim: Any
    link: str
    mesh: Mesh
    seen: bool
    felt: bool


class _Reader:
    def __init__(self, path: Path, max_bytes: int) -> None:
        self.path, self.stage = path, UsdStage(path, max_bytes)
        self.physics, self.shade = (
            require(f"pxr.{n}", "artiworld[usd]", "USD") for n in ("UsdPhysics", "UsdShade")
        )
        self.get = self.stage.get
        self.notes: list[str] = []
        self.link_of: dict[Any, str] = {}  # path of a body's prim → its link
        self.still: set[Any] = set()  # paths above static shapes
        self.taken = {WORLD}
        self.joint_names: set[str] = set()
        self.static: dict[Any, str] = {}  # path → name of what joints hang on without a body
        self.kilograms = float(self.physics.GetStageKilogramsPerUnit(self.stage.stage) or 1.0)

    def read(self) -> UrdfModel | None:
        prims = list(self.stage.walk())
        bodies = [p for p, _ in prims if self.stage.is_body(p)]
        if len(bodies) > MOST_BODIES:
            raise InputFileError(self.path, f"has {len(bodies)} bodies", "cut the stage")
        for body in bodies:
            self.link_of[body.GetPath()] = self._name(body, self.taken)
        for prim, seen in prims:
            if seen and self.stage.is_shape(prim) and self.stage.body_of(prim) is None:
                self.still.update(prim.GetPath().GetPrefixes()[:-1])
        written = (self._joint(p) for p, _ in prims if p.IsA(self.physics.Joint))
        joined = [j for j in written if j is not None]
        if all(j.type == "fixed" for j in joined) or self._several(joined):
            return None
        top = self._top(joined)
        pieces = list(self._pieces(prims, top))
        if not any(p.seen for p in pieces):
            raise InputFileError(self.path, "no body has a mesh that can be seen", "add one")
        self.notes += self.stage.unread(p for p, seen in prims if seen)
        bodies = [b for b in bodies if b.GetPath().HasPrefix(top)]
        self.link_of = {b.GetPath(): self.link_of[b.GetPath()] for b in bodies}
        return self._model(bodies, joined, pieces)

    def _name(self, prim: Any, taken: set[str]) -> str:
        said = prim.GetCustomDataByKey(NAME_KEY)
        name = free_name(said if isinstance(said, str) and said else str(prim.GetName()), taken)
        taken.add(name)
        return name

    # The object

    def _several(self, joints: list[_Link]) -> bool:
        """True if joints that move hold more than one group of bodies: a scene of objects. What
        they hang on without a body is one, too."""
        groups: list[set[str]] = []
        for joint in joints:
            ends = {joint.zero, joint.one, str(joint.home or WORLD)} - {WORLD}
            touching = [group for group in groups if group & ends]
            groups = [g for g in groups if g not in touching] + [ends.union(*touching)]
        moving = {j.zero if j.one == WORLD else j.one for j in joints if j.type != "fixed"}
        return sum(bool(group & moving) for group in groups) > 1

    def _top(self, joined: list[_Link]) -> Any:
        """Path of the prim that holds all that is joined."""
        ends = {end for j in joined for end in (j.zero, j.one)}
        homes = (j.home for j in joined if j.home and j.type != "fixed")
        held = [*(path for path, link in self.link_of.items() if link in ends), *homes]
        top = reduce(lambda a, b: a.GetCommonPrefix(b), held)
        return top.GetParentPath() if top in self.link_of else top

    def _pieces(self, prims: Iterable[tuple[Any, bool]], top: Any) -> Iterator[_Piece]:
        """Shapes below ``top``; others, what no body holds where no joint hangs on it, and grounds
        are surroundings, which are remarked."""
        away = []
        for prim, seen in prims:
            felt = prim.HasAPI(self.physics.CollisionAPI)
            felt = felt and self.get(prim, "physics:collisionEnabled") is not False
            if not (seen or felt) or not self.stage.is_shape(prim):
                continue
            link = self._holder(prim)
            if not prim.GetPath().HasPrefix(top) or (link == WORLD and not self.static):
                away += [prim.GetPath()] * seen
                continue
            made = self.stage.shape_of(prim).moved(self.stage.world(prim))
            mesh = to_mesh(cleaned(self.path, made, np.eye(4), 1.0))
            size = np.ptp(mesh.bounds, axis=0)
            if link == WORLD and size[:2].min() > WIDE:
                extent = f"{size[0]:.3g} x {size[1]:.3g} m: taken for a ground, left out"
                self.notes.append(f"{prim.GetName()} is {extent}")
                continue
            yield _Piece(prim, link, mesh, seen, felt)
        self.notes += beside("surroundings left out", away, top)

    def _holder(self, prim: Any) -> str:
        """The link of a prim's body; "" where that isn't active."""
        body = self.stage.body_of(prim)
        return self.link_of.get(body.GetPath(), "") if body else WORLD

    # Joints

    def _joint(self, prim: Any) -> _Link | None:
        """One joint, with both its frames; None for one that is off, or joins nothing: remarked."""
        said = f"joint {str(prim.GetName())!r}"
        (zero, named, at_zero), (one, other, at_one) = (
            self._end(prim.GetRelationship(f"physics:body{k}")) for k in (0, 1)
        )
        off = self.get(prim, "physics:jointEnabled") is False
        if off or zero == one or not (zero and one):
            self.notes.append(f"{said} {'is switched off' if off else 'joins nothing'}: left out")
            return None
        type_, axis, drive, limits = self._freedom(prim, said)
        onto = affine(np.eye(3)[:, {"X": [0, 1, 2], "Y": [1, 2, 0], "Z": [2, 0, 1]}[axis]])
        zeros, ones = (
            self._frame(at, *(self.get(prim, f"physics:local{n}{k}") for n in ("Pos", "Rot")))
            @ onto
            for k, at in enumerate((at_zero, at_one))
        )
        value = self._value(said, prim, type_, np.linalg.inv(zeros) @ ones)
        unit = math.pi / 180 if type_ == "revolute" else self.stage.unit
        home = next((p for p in (named, other) if p in self.static), None)
        if home is None and WORLD in (zero, one) and type_ != "fixed":
            above = reversed((named or other).GetParentPath().GetPrefixes())
            home = next((p for p in above if p in self.still), None)
            self.static |= {home: str(home.name)} if home else {}
        return _Link(prim, zero, one, home, type_, drive, limits, zeros, value, unit)

    def _freedom(self, prim: Any, said: str) -> tuple[JointType, str, str, tuple[Any, ...]]:
        """Type, axis, drive, and limits as written: those of the one free axis of a joint without a
        type."""
        kind = str(prim.GetTypeName())
        type_: JointType = _TYPES.get(kind, "fixed")
        axis = "X" if type_ == "fixed" else str(self.get(prim, "physics:axis") or "X")
        drive = "angular" if type_ == "revolute" else "linear"
        limits = tuple(self.get(prim, f"physics:{end}Limit") for end in ("lower", "upper"))
        free = {}
        for each in _AXES if kind == "PhysicsJoint" else ():
            ends = tuple(self.get(prim, f"limit:{each}:physics:{end}") for end in ("low", "high"))
            if None in ends or ends[0] < ends[1]:
                free[each] = ends
        if len(free) == 1:
            ((drive, limits),) = free.items()
            type_, axis = _AXES[drive], drive[-1]
        elif kind not in _TYPES and (free or kind != "PhysicsJoint"):
            also = f", free along {', '.join(free)}" if free else ""
            self.notes.append(f"{said} of type {kind}: read as fixed{also}")
        return type_, axis, drive, limits

    def _end(self, relation: Any) -> tuple[str, Any, FloatArray]:
        """The link that a joint's end lies on, and path and (4, 4) of what it names: the world as
        None."""
        targets = relation.GetForwardedTargets()
        prim = self.stage.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not prim:
            what = f"a joint names {targets[0]}, which isn't on the stage"
            raise InputFileError(self.path, what, "export it again")
        if prim is None or prim.IsPseudoRoot():
            return WORLD, None, self.stage.turn @ np.eye(4)
        if self.stage.body_of(prim) is None:
            self.static[prim.GetPath()] = str(prim.GetName())
        return self._holder(prim), prim.GetPath(), self.stage.world(prim) @ self.stage.turn

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

    def _value(self, said: str, prim: Any, type_: JointType, apart: FloatArray) -> float:
        """Present joint value; adds a remark where the joint's frames differ by anything else."""
        shift, turn = apart[:3, 3].copy(), Rotation.from_matrix(apart[:3, :3]).as_rotvec()
        value, moved = 0.0, shift if JOINT_KINDS[type_].slides else turn
        if type_ != "fixed":
            value, moved[0] = float(moved[0]), 0.0
        away, askew = np.linalg.norm(shift), np.degrees(np.linalg.norm(turn))
        differ = [f"{away:.3g} m"] * bool(away > APART)
        differ += [f"{askew:.3g} degrees"] * bool(askew > ASKEW and prim.GetTypeName() != BALL)
        if differ and type_ != "fixed":
            both = " and ".join(differ)
            self.notes.append(f"{said}: its frames stand {both} apart; that of body 0 counts")
        return 0.0 if abs(value) < 1e-6 else value

    # The model

    def _model(self, bodies: list[Any], joined: list[_Link], pieces: list[_Piece]) -> UrdfModel:
        # Without names: parts are called after their bodies.
        shapes = [UrdfVisual(p.link, None, np.eye(4), mesh=p.mesh) for p in pieces]
        visuals = tuple(v for v, piece in zip(shapes, pieces, strict=True) if piece.seen)
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
        mimics = self._mimics(written)
        joints = [replace(j, mimic=mimics.get(j.name)) for j in joints]
        felt: dict[str, list[UrdfVisual]] = {}
        for shape, piece in zip(shapes, pieces, strict=True):
            if piece.felt:
                made = replace(shape, mesh=self._collider(piece))
                felt.setdefault(piece.link, []).append(made)
        moving = {j.name: written[j.name] for j in joints if j.moves and j.name in written}
        said = ((n, self._dynamics(link)) for n, link in moving.items())
        declared = DeclaredPhysics(
            dict(self._inertials(bodies, pieces)),
            {n: d for n, d in said if d is not None},
            (),
            {link: DeclaredCollision(tuple(held)) for link, held in felt.items()},
            tuple(self._affordances({j.name: j for j in joints})),
        )
        top = self.stage.stage.GetDefaultPrim()
        return model_from(
            self.path,
            str(top.GetName()) if top else self.path.stem,
            links,
            joints,
            visuals,
            self.notes,
            declared,
            part_names=dict(self._labels(bodies)),
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
                self.notes.append(f"body {start!r} hangs on no joint: it stays where it stands")
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
        low, high = (
            inf if end is None or not abs(end) <= UNLIMITED else end * joint.unit - joint.value
            for end, inf in zip(joint.limits, (-math.inf, math.inf), strict=True)
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
        if prim is None or prim.GetTypeName() != BALL:
            return (joint,)
        cone = self.get(prim, "physics:coneAngle0Limit")
        swing = math.radians(cone) if cone is not None and 0 <= cone < 90 else math.pi / 2
        tilts = f"three turns, two of them up to {math.degrees(swing):.3g} degrees"
        self.notes.append(f"joint {joint.name!r} is a ball: read as {tilts}")
        helpers = free_helpers(joint.child, 2, links)
        links += helpers
        return composite_joints(Composite("ball"), joint, helpers, swing=swing)

    def _mimics(self, written: dict[str, _Link]) -> dict[str, Mimic]:
        """PhysX: q + gearing * q(leader) + offset = 0; Newton and MuJoCo: q = coefficient 1 *
        q(leader) + coefficient 0; in degrees or the unit, MuJoCo's in rad or m."""
        at = {link.prim.GetPath(): name for name, link in written.items()}
        out: dict[str, Mimic] = {}
        for name, link in written.items():
            prim, sign = link.prim, 1.0
            follows = (k for k in _FOLLOWS.items() if prim.GetRelationship(k[0]).GetTargets())
            keys = next(((lead, f"{c}1", f"{c}0") for lead, c in follows), ("", "", ""))
            names = (str(p.GetName()).rpartition(":") for p in prim.GetProperties())
            base = next((b for b, _, n in names if n in ("gearing", "referenceJoint")), "")
            if base:
                keys, sign = (f"{base}:referenceJoint", f"{base}:gearing", f"{base}:offset"), -1.0
            lead, factor, more = keys
            if not lead or self.get(prim, "newton:mimicEnabled") is False:
                continue
            targets = prim.GetRelationship(lead).GetTargets()
            leader = at.get(targets[0]) if targets else None
            if leader is None or leader == name:
                self.notes.append(f"joint {name!r} follows a joint that isn't there: on its own")
                continue
            theirs, by = written[leader], self.get(prim, factor)
            if base and by is None:
                self.notes.append(f"joint {name!r} follows without a stated gearing: 1 is taken")
            units = (1.0, 1.0) if lead.startswith("mjc") else (link.unit, theirs.unit)
            multiplier = sign * (1.0 if by is None else float(by)) * units[0] / units[1]
            # Values are counted from where the joints stand.
            shift = multiplier * theirs.value - link.value
            offset = sign * float(self.get(prim, more) or 0.0) * units[0]
            out[name] = Mimic(leader, multiplier, offset + shift)
        return out

    def _dynamics(self, joint: _Link) -> DeclaredDynamics | None:
        force = self.kilograms * self.stage.unit ** (2 if joint.type == "revolute" else 1)
        base, prim = f"drive:{joint.drive}:physics", joint.prim
        by_force = self.get(prim, f"{base}:type") != "acceleration"
        if not by_force and self.get(prim, f"{base}:damping"):
            self.notes.append(f"joint {str(prim.GetName())!r}: damping by acceleration is left out")
        values = (
            _above(self.get(prim, name)) * unit or None
            for name, unit in (
                (f"{base}:damping", by_force * force / joint.unit),
                (FRICTION, force),
                (f"{base}:maxForce", force),
                ("physxJoint:maxJointVelocity", joint.unit),
            )
        )
        found = DeclaredDynamics(*values)
        return None if found == DeclaredDynamics() else found

    # Bodies

    def _inertials(self, bodies: list[Any], pieces: list[_Piece]) -> Iterator[tuple[str, Inertial]]:
        """Link and inertial of bodies that state a mass or a density; the rest by the hulls of
        their collision shapes, else of what is seen."""
        held: dict[str, list[_Piece]] = {}
        for piece in pieces:
            held.setdefault(piece.link, []).append(piece)
        for body in bodies:
            link, get = self.link_of[body.GetPath()], self.get
            mine = held.get(link, [])
            own = [self._of_piece(p, body) for p in [p for p in mine if p.felt] or mine]
            mass = _above(get(body, "physics:mass")) * self.kilograms
            solid = together([made for made, _ in own]) if own else None
            if not mass and not any(stated for _, stated in own):
                continue  # worked out from the shapes, as simulators do
            mass = mass or (solid.mass if solid else 0.0)
            place = get(body, "physics:centerOfMass")
            known = body.GetAttribute("physics:centerOfMass").HasAuthoredValue()
            known = known and bool(np.isfinite(place).all())
            world = self.stage.world(body) @ self.stage.turn
            frame = self._frame(world, place if known else None, get(body, "physics:principalAxes"))
            turn, center = frame[:3, :3], frame[:3, 3]
            center = center if known or solid is None else solid.center
            diagonal = np.asarray(get(body, "physics:diagonalInertia") or (0, 0, 0), np.float64)
            scale, found = self.kilograms * self.stage.unit**2, None
            if (diagonal > 0).all():
                found = Inertial(mass, center, turn @ np.diag(diagonal * scale) @ turn.T)
            if found and inertial_problems({link: found}):
                self.notes.append(f"link {link!r}: its inertia is no body's; worked out again")
                found = None
            if solid is not None and found is None:
                found = Inertial(mass, center, solid.tensor * (mass / solid.mass))
            if found is not None:
                yield link, found

    def _of_piece(self, piece: _Piece, body: Any) -> tuple[Inertial, bool]:
        """A shape's mass properties, and True where its mass or density is stated: that of the
        shape counts before the body's, and last that of its material."""
        bound = self.shade.MaterialBindingAPI(piece.prim).ComputeBoundMaterial("physics")[0]
        prims = (piece.prim, body, bound.GetPrim())
        said = [_above(self.get(prim, "physics:density")) for prim in prims if prim]
        density = next((d for d in said if d), 0.0) * self.kilograms / self.stage.unit**3
        own = _above(self.get(piece.prim, "physics:mass")) * (piece.prim != body) * self.kilograms
        made = hull_inertial(piece.mesh.vertices, density or DENSITY)
        if own:
            made = Inertial(own, made.center, made.tensor * (own / made.mass))
        return made, density > 0 or own > 0

    def _affordances(self, joints: Mapping[str, Joint]) -> Iterator[Affordance]:
        """Lines that say where a robot takes hold, as our exporter writes them."""
        for prim in self.stage.stage.Traverse():
            kind = self.get(prim, f"{AFFORDANCE}:kind")
            if kind is None:
                continue
            said = {
                k: self.get(prim, f"{AFFORDANCE}:{k}")
                for k in ("joint", "center", "normal", "closing", "width")
            }
            joint = joints.get(str(said["joint"]))
            if joint is None:
                continue
            world = self.stage.world(prim) @ self.stage.turn
            matrix = world[:3, :3] * self.stage.unit
            try:
                center, *turned = (
                    matrix @ np.asarray(said[k], np.float64)
                    for k in ("center", "normal", "closing")
                )
                unit = [tuple((v / np.linalg.norm(v)).tolist()) for v in turned]
                width = float(said["width"] or 0.0) * uniform_scale(matrix)
                at = tuple((center + world[:3, 3] - np.asarray(joint.origin)).tolist())
                yield Affordance(joint.name, joint.child, str(kind), at, *unit, width)  # type: ignore[arg-type]
            except (GeometryError, TypeError, ValueError) as error:
                self.notes.append(f"{prim.GetName()}: {error}; it is left out")

    def _collider(self, piece: _Piece) -> Mesh:
        """The hull of a shape where the stage says so, else its mesh."""
        hulled = self.get(piece.prim, "physics:approximation") == "convexHull"
        hull = hull_of(np.asarray(piece.mesh.vertices, np.float64)) if hulled else None
        return piece.mesh if hull is None else Mesh(hull.vertices, hull.faces)

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


def _above(value: Any) -> float:
    """A number above 0 and below what stands for none, else 0."""
    return float(value) if isinstance(value, int | float) and 0 < value < MOST else 0.0
