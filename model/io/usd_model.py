"""Read the articulation of a USD stage (UsdPhysics) into the same model as a URDF.

Rigid bodies are links, in the stage's world frame turned to +z up, metres, as they stand. What no
body holds belongs to the link ``world``. Conventions of joints are those of the schema: body 1
moves against body 0, revolute limits are degrees, and lengths are in the stage's unit.
"""

from __future__ import annotations

import math
from collections import deque
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
from model.core.geometry import uniform_scale
from model.core.joint import JOINT_KINDS, JOINT_TYPES, DeclaredDynamics, Joint, JointType, Mimic
from model.core.packages import require
from model.core.tree import KinematicTree
from model.io.export.usd import AFFORDANCE, FRICTION, NAME_KEY
from model.io.formats.loaded import DEFAULT_MAX_BYTES, size_of
from model.io.formats.usd import UsdStage, sound_stage
from model.io.geometry_files import cleaned, to_mesh
from model.io.urdf.meshes import DeclaredCollision, UrdfVisual
from model.io.urdf.model import DeclaredPhysics, UrdfModel, renamed_helpers
from model.io.urdf.sdf import UNLIMITED

WORLD = "world"
MOST_BODIES = 5000
"""More are no object; as for a URDF's links."""
FULL_TURN = 2 * math.pi - 1e-6
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
    if size_of(path) > max_bytes:
        raise InputFileError(path, "is over the limit of bytes", "thin or cut its meshes first")
    with sound_stage(path):
        return _Reader(path).read()


@dataclass(frozen=True)
class _Link:
    """A joint as written: between two links, with its frames in the world.

    Attributes:
        prim: the joint. zero, one: the links that it joins.
        type: of the joint.
        frame: (4, 4) joint frame on body 0, turned so that the axis is x.
        value: where it stands, rad or m.
    """

    prim: Any
    zero: str
    one: str
    type: JointType
    frame: FloatArray
    value: float


class _Reader:
    def __init__(self, path: Path) -> None:
        self.path, self.stage = path, UsdStage(path)
        self.physics = require("pxr.UsdPhysics", "artiworld[usd]", "USD")
        self.notes: list[str] = []
        self.link_of: dict[Any, str] = {}  # path of a body's prim → its link
        self.taken = {WORLD}
        self.joint_names: set[str] = set()

    def read(self) -> UrdfModel | None:
        api = self.physics.RigidBodyAPI
        # Instances hold neither bodies nor joints.
        prims = [
            p for p in self.stage.stage.Traverse() if p.HasAPI(api) or p.IsA(self.physics.Joint)
        ]
        bodies = [p for p in prims if p.HasAPI(api) and not p.IsA(self.physics.Joint)]
        if len(bodies) > MOST_BODIES:
            raise InputFileError(self.path, f"has {len(bodies)} bodies", "cut the stage")
        for body in bodies:
            self.link_of[body.GetPath()] = self._name(body, self.taken)
        found = [self._joint(p) for p in prims if p.IsA(self.physics.Joint)]
        joined = [j for j in found if j is not None]
        if not any(j.type != "fixed" for j in joined) or self._several(joined):
            return None
        visuals = tuple(self._shapes(self.stage.prims(), seen=True))
        if not visuals:
            raise InputFileError(self.path, "no body has a mesh that can be seen", "add one")
        return self._model(bodies, joined, visuals)

    def _name(self, prim: Any, taken: set[str]) -> str:
        said = prim.GetCustomDataByKey(NAME_KEY)
        name = free_name(said if isinstance(said, str) and said else str(prim.GetName()), taken)
        taken.add(name)
        return name

    def _several(self, joints: list[_Link]) -> bool:
        """True if joints that move hold more than one group of bodies: a scene of objects."""
        group = {link: link for link in (WORLD, *self.link_of.values())}

        def top(link: str) -> str:
            while group[link] != link:
                link = group[link]
            return link

        for joint in joints:
            if WORLD not in (joint.zero, joint.one):
                group[top(joint.one)] = top(joint.zero)
        return (
            len({top(j.zero if j.one == WORLD else j.one) for j in joints if j.type != "fixed"}) > 1
        )

    # Geometry

    def _holder(self, prim: Any) -> str:
        at = prim
        while at and at.GetPath() not in self.link_of:
            at = at.GetParent()
        return self.link_of[at.GetPath()] if at else WORLD

    def _shapes(self, prims: Any, *, seen: bool) -> Iterator[UrdfVisual]:
        for prim in prims:
            if not seen and not prim.HasAPI(self.physics.CollisionAPI):
                continue
            made = self.stage.shape_of(prim)
            if made is None:
                continue
            world = made.moved(self.stage.world(prim) @ self.stage.into)
            loaded = cleaned(self.path, world, np.eye(4), 1.0)
            yield UrdfVisual(
                self._holder(prim), str(prim.GetName()), np.eye(4), mesh=to_mesh(loaded)
            )

    # Joints

    def _joint(self, prim: Any) -> _Link | None:
        """One joint, with both its frames; None for one that is off, or joins nothing."""
        joint = self.physics.Joint(prim)
        if joint.GetJointEnabledAttr().Get() is False:
            return None
        ends = [self._end(joint.GetBody0Rel()), self._end(joint.GetBody1Rel())]
        if ends[0][0] == ends[1][0]:
            self.notes.append(f"joint {str(prim.GetName())!r} joins nothing: left out")
            return None
        kind = str(prim.GetTypeName())
        type_ = _TYPES.get(kind, "fixed")
        if kind not in _TYPES:
            self.notes.append(f"joint {str(prim.GetName())!r} of type {kind}: read as fixed")
        axis = "X"
        if type_ != "fixed":
            axis = str(prim.GetAttribute("physics:axis").Get() or "X")
        onto = np.eye(4)
        onto[:3, :3] = np.eye(3)[:, {"X": [0, 1, 2], "Y": [1, 2, 0], "Z": [2, 0, 1]}[axis]]
        frames = []
        for k, (_, world) in enumerate(ends):
            place = getattr(joint, f"GetLocalPos{k}Attr")().Get() or (0, 0, 0)
            turn = getattr(joint, f"GetLocalRot{k}Attr")().Get()
            frames.append(self._frame(world, place, turn) @ onto)
        return _Link(
            prim,
            ends[0][0],
            ends[1][0],
            type_,
            frames[0],
            self._value(prim, type_, frames[0], frames[1]),
        )

    def _end(self, relation: Any) -> tuple[str, FloatArray]:
        """The link that a joint's end lies on, and (4, 4) of the prim that it names."""
        targets = relation.GetForwardedTargets()
        prim = self.stage.stage.GetPrimAtPath(targets[0]) if targets else None
        if targets and not prim:
            what = f"a joint names {targets[0]}, which isn't on the stage"
            raise InputFileError(self.path, what, "export it again")
        if prim is None:
            return WORLD, self.stage.turn @ np.eye(4)
        return self._holder(prim), self.stage.world(prim) @ self.stage.turn

    def _frame(self, world: FloatArray, place: Any, turn: Any) -> FloatArray:
        """(4, 4) rigid frame in metres, +z up, of a place and a turn in a prim's own frame."""
        out = np.eye(4)
        scaled = world[:3, :3]
        out[:3, 3] = scaled @ (np.asarray(place, np.float64) * self.stage.unit) + world[:3, 3]
        rotation = scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-12)
        out[:3, :3] = rotation
        if turn is not None:
            x, y, z = turn.GetImaginary()
            local = np.array([x, y, z, turn.GetReal()], np.float64)
            if np.linalg.norm(local) > 1e-9:
                out[:3, :3] = rotation @ Rotation.from_quat(local).as_matrix()
        return out

    def _value(self, prim: Any, type_: JointType, zero: FloatArray, one: FloatArray) -> float:
        """Present joint value; adds a remark where the joint's frames differ by anything else."""
        apart = np.linalg.inv(zero) @ one
        shift, turn = apart[:3, 3].copy(), Rotation.from_matrix(apart[:3, :3]).as_rotvec()
        value = turn[0] if JOINT_KINDS[type_].rotates else 0.0
        if JOINT_KINDS[type_].slides:
            value, shift[0] = shift[0], 0.0
        if type_ != "fixed" and np.linalg.norm(shift) > APART:
            away = np.linalg.norm(shift)
            self.notes.append(
                f"joint {str(prim.GetName())!r}: its frames stand {away:.3g} m apart; "
                "that of body 0 counts"
            )
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
        try:
            tree = KinematicTree(
                tuple(renamed.get(n, n) for n in links),
                tuple(
                    replace(
                        j,
                        parent=renamed.get(j.parent, j.parent),
                        child=renamed.get(j.child, j.child),
                        mimic=mimics.get(j.name),
                    )
                    for j in joints
                ),
            )
        except KinematicsError as error:
            raise InputFileError(self.path, str(error)) from None
        felt: dict[str, list[UrdfVisual]] = {}
        for shape in self._shapes((p for _, p in self.stage.all_prims()), seen=False):
            felt.setdefault(renamed.get(shape.link, shape.link), []).append(shape)
        moving = {j.name: written[j.name] for j in joints if j.moves and j.name in written}
        said = ((n, self._dynamics(link)) for n, link in moving.items())
        declared = DeclaredPhysics(
            self._inertials(bodies, renamed),
            {n: d for n, d in said if d is not None},
            (),
            {link: DeclaredCollision(tuple(held)) for link, held in felt.items()},
            tuple(self._affordances(tree)),
        )
        labels = {renamed.get(link, link): text for link, text in self._labels(bodies)}
        top = self.stage.stage.GetDefaultPrim()
        name = str(top.GetName()) if top else self.path.stem
        return UrdfModel(
            self.path,
            name,
            tree,
            visuals,
            tuple(dict.fromkeys([*self.notes, *renotes])),
            renamed=tuple(renotes),
            declared=declared,
            part_names=labels,
            category=_label(top) if top else None,
        )

    def _tree(self, links: list[str], joined: list[_Link]) -> tuple[list[Joint], dict[str, _Link]]:
        """Joints from the root outwards, and what each was written as."""
        moved = {j.one for j in joined}
        root = links[0] if links[0] == WORLD else next((n for n in links if n not in moved), "")
        root = root or links[0]
        near: dict[str, list[_Link]] = {}
        for joint in joined:
            near.setdefault(joint.zero, []).append(joint)
            near.setdefault(joint.one, []).append(joint)
        out: list[Joint] = []
        written: dict[str, _Link] = {}
        reached, used = {root}, set[int]()
        for start in (root, *links):
            if start not in reached:  # stands apart
                name = free_name(f"fixed_{start}", self.joint_names)
                self.joint_names.add(name)
                out.append(Joint(name, "fixed", root, start))
                reached.add(start)
            ahead = deque([start])
            while ahead:
                link = ahead.popleft()
                for joint in near.get(link, ()):
                    other = joint.one if joint.zero == link else joint.zero
                    if id(joint) in used:
                        continue
                    used.add(id(joint))
                    if other in reached:
                        said = str(joint.prim.GetName())
                        self.notes.append(f"joint {said!r} closes a loop: left out")
                        continue
                    made = self._made(joint, link, other)
                    out.append(made)
                    written[made.name] = joint
                    reached.add(other)
                    ahead.append(other)
        return out, written

    def _made(self, joint: _Link, parent: str, child: str) -> Joint:
        name = self._name(joint.prim, self.joint_names)
        if joint.type == "fixed":
            return Joint(name, "fixed", parent, child)
        sign = 1.0 if parent == joint.zero else -1.0
        axis = sign * joint.frame[:3, 0]
        ends = [joint.prim.GetAttribute(f"physics:{n}Limit").Get() for n in ("lower", "upper")]
        unit = math.pi / 180 if joint.type == "revolute" else self.stage.unit
        low, high = (
            inf if value is None or not abs(value) <= UNLIMITED else value * unit - joint.value
            for value, inf in zip(ends, (-math.inf, math.inf), strict=True)
        )
        type_, limits = joint.type, (low, high)
        if joint.type == "revolute" and not high - low < FULL_TURN:
            type_, limits = "continuous", (None, None)
        elif not (math.isfinite(low) and math.isfinite(high)) or low > high:
            self.notes.append(f"joint {name!r} has no range: it is taken as 0")
            limits = (0.0, 0.0)
        a, o = axis.tolist(), joint.frame[:3, 3].tolist()
        return Joint(name, type_, parent, child, (a[0], a[1], a[2]), (o[0], o[1], o[2]), *limits)

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
        """PhysX's mimic joints: q + gearing * q(leader) + offset = 0, in degrees or the unit."""
        at = {link.prim.GetPath(): name for name, link in written.items()}
        out: dict[str, Mimic] = {}
        for name, link in written.items():
            names = (a.GetName() for a in link.prim.GetAttributes())
            base = next((n.rpartition(":")[0] for n in names if n.endswith(":gearing")), None)
            if base is None:
                continue
            targets = link.prim.GetRelationship(f"{base}:referenceJoint").GetTargets()
            leader = at.get(targets[0]) if targets else None
            if leader is None or leader == name:
                self.notes.append(f"joint {name!r} follows a joint that isn't there: on its own")
                continue
            theirs = written[leader]
            units = [
                math.pi / 180 if j.type == "revolute" else self.stage.unit for j in (link, theirs)
            ]
            gearing, offset = (
                float(link.prim.GetAttribute(f"{base}:{key}").Get() or 0.0)
                for key in ("gearing", "offset")
            )
            multiplier = -gearing * units[0] / units[1]
            # Values are counted from where the joints stand.
            shift = multiplier * theirs.value - link.value
            out[name] = Mimic(leader, multiplier, -offset * units[0] + shift)
        return out

    def _dynamics(self, joint: _Link) -> DeclaredDynamics | None:
        kind = "angular" if joint.type == "revolute" else "linear"
        get = joint.prim.GetAttribute
        damping, effort, friction = (
            float(value) if isinstance(value, int | float) and 0 < value < 1e12 else None
            for value in (
                get(f"drive:{kind}:physics:damping").Get(),
                get(f"drive:{kind}:physics:maxForce").Get(),
                get(FRICTION).Get(),
            )
        )
        if damping is not None and kind == "angular":
            damping *= 180 / math.pi
        if damping is None and friction is None and effort is None:
            return None
        return DeclaredDynamics(damping, friction, effort)

    # Bodies

    def _inertials(self, bodies: list[Any], renamed: dict[str, str]) -> dict[str, Inertial]:
        out: dict[str, Inertial] = {}
        kilograms = float(self.physics.GetStageKilogramsPerUnit(self.stage.stage) or 1.0)
        for body in bodies:
            api = self.physics.MassAPI(body)
            mass = float(api.GetMassAttr().Get() or 0.0) * kilograms
            diagonal = np.asarray(api.GetDiagonalInertiaAttr().Get() or (0, 0, 0), np.float64)
            if not (body.HasAPI(self.physics.MassAPI) and mass > 0 and (diagonal > 0).all()):
                continue  # worked out from the shapes, as simulators do
            center = api.GetCenterOfMassAttr().Get() or (0, 0, 0)
            world = self.stage.world(body) @ self.stage.turn
            frame = self._frame(world, center, api.GetPrincipalAxesAttr().Get())
            turn = frame[:3, :3]
            tensor = turn @ np.diag(diagonal * kilograms * self.stage.unit**2) @ turn.T
            link = renamed.get(self.link_of[body.GetPath()], self.link_of[body.GetPath()])
            found = Inertial(mass, frame[:3, 3], tensor)
            if inertial_problems({link: found}):
                self.notes.append(f"link {link!r}: its inertia is no body's; worked out again")
                continue
            out[link] = found
        return out

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
                center = matrix[:3, :3] @ np.asarray(said["center"], np.float64) + matrix[:3, 3]
                turned = [
                    matrix[:3, :3] @ np.asarray(said[k], np.float64) for k in ("normal", "closing")
                ]
                unit = [tuple((v / np.linalg.norm(v)).tolist()) for v in turned]
                width = float(said["width"] or 0.0) * uniform_scale(matrix[:3, :3])
                at = tuple((center - np.asarray(joint.origin)).tolist())
                yield Affordance(joint.name, joint.child, str(kind), at, *unit, width)  # type: ignore[arg-type]
            except (GeometryError, TypeError, ValueError) as error:
                self.notes.append(f"{prim.GetName()}: {error}; it is left out")

    def _labels(self, bodies: list[Any]) -> Iterator[tuple[str, str]]:
        for body in bodies:
            if (label := _label(body)) is not None:
                yield self.link_of[body.GetPath()], label


def _label(prim: Any) -> str | None:
    """A prim's first class label."""
    attribute = prim.GetAttribute(_LABEL)
    labels = list(attribute.Get() or ()) if attribute else []
    return str(labels[0]).strip() or None if labels else None
