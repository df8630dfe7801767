"""The joints driven there and back in MuJoCo, without gravity and with it."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal
from xml.etree import ElementTree as ET  # only writes

import numpy as np
import numpy.typing as npt

from model.exporters.inertia import inertials_of
from model.gate.physics_report import PhysicsReport
from model.kinematics.articulated_object import ArticulatedObject
from model.kinematics.joint import Joint
from model.kinematics.urdf import link_origins, vector
from model.progress import Progress, no_progress

Colliders = Literal["none", "shapes"]

STEP = 0.002
"""Seconds."""
DRIVE = 0.4
"""Seconds to one end of a range, and as many back."""
STIFFNESS = 100.0
"""1/s: how fast the position drives answer; they are critically damped for what they carry."""
GROUPS = 12
"""Joints of larger objects are driven several at a time."""
SAG = 2 * 9.81 / STIFFNESS**2
"""Metres that a drive gives way under twice the weight that it was made for; the same in radians
on a lever of a metre."""
OUTSIDE = 0.2
"""Share of the range beyond a limit that counts as exploded."""
DRIFT, MISS = 0.1, 0.1

FloatArray = npt.NDArray[np.float64]


def run_physics(
    obj: ArticulatedObject,
    *,
    colliders: Colliders = "none",
    progress: Progress = no_progress,
) -> PhysicsReport:
    """Drive each joint to both ends of its range and back while the others hold still.

    Args:
        colliders: "shapes" lets the links collide as they do in an exported asset, which takes
            the making of the shapes; "none" drives masses and joints alone.
    """
    if importlib.util.find_spec("mujoco") is None:
        return PhysicsReport(False, "MuJoCo is not installed: pip install 'artiworld[physics]'")
    mujoco: Any = importlib.import_module("mujoco")
    joints = [j for j in obj.tree.joints if _drivable(j)]
    if not joints:
        return PhysicsReport(True, colliders=colliders)
    shapes = _shapes(obj) if colliders == "shapes" else {}
    try:
        model = mujoco.MjModel.from_xml_string(_xml(obj, joints, shapes))
    except ValueError as error:
        return PhysicsReport(False, f"MuJoCo can't load it: {str(error)[:200]}")
    run = _Run(model, joints)
    for k, gravity in enumerate((0.0, -9.81)):
        run.all_joints(gravity, lambda f, k=k: progress(0.75 + 0.075 * (k + f), "Running physics"))
    return PhysicsReport(True, "", run.exploded, run.drifted, run.missed, colliders, run.seconds)


def _drivable(joint: Joint) -> bool:
    if not joint.moves:
        return False
    return not joint.limited or (joint.upper or 0.0) - (joint.lower or 0.0) > 1e-6


def _shapes(obj: ArticulatedObject) -> dict[str, list[FloatArray]]:
    """Link → corners of convex bodies, object frame."""
    from model.collision.build import collision_of
    from model.collision.shapes import hull_of_shape

    made = collision_of(obj)
    return {k: [hull_of_shape(s).vertices for s in shapes] for k, shapes in made.items()}


def _xml(
    obj: ArticulatedObject, joints: Sequence[Joint], shapes: Mapping[str, Sequence[FloatArray]]
) -> str:
    """The object with its base fixed to the world; names are numbers of links and joints."""
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", balanceinertia="true")
    ET.SubElement(root, "option", timestep=str(STEP), integrator="implicitfast")
    assets = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    tree, inertials, origins = obj.tree, inertials_of(obj), link_origins(obj.tree)
    number = {link: k for k, link in enumerate(tree.order)}
    bodies: dict[str, ET.Element] = {}
    for link in tree.order:
        joint = tree.joint_of.get(link)
        at = origins[link] - (origins[joint.parent] if joint is not None else 0.0)
        parent = world if joint is None else bodies[joint.parent]
        body = bodies[link] = ET.SubElement(parent, "body", name=f"b{number[link]}", pos=vector(at))
        if joint is not None and joint in joints:
            _joint(body, joint, joints.index(joint))
        _inertial(body, inertials.get(link), origins[link])
        for k, corners in enumerate(shapes.get(link, ())):
            name = f"m{number[link]}_{k}"
            flat = " ".join(f"{v:.6g}" for v in (corners - origins[link]).ravel())
            ET.SubElement(assets, "mesh", name=name, vertex=flat)
            ET.SubElement(body, "geom", type="mesh", mesh=name, mass="0")
    _followers(root, joints)
    drives = ET.SubElement(root, "actuator")
    for k, joint in enumerate(joints):
        if joint.mimic is None:
            ET.SubElement(drives, "position", name=f"a{k}", joint=f"j{k}", kp="1", kv="1")
    return ET.tostring(root, encoding="unicode")


def _joint(body: ET.Element, joint: Joint, number: int) -> None:
    kind = "hinge" if joint.rotates else "slide"
    made = ET.SubElement(
        body, "joint", name=f"j{number}", type=kind, axis=vector(joint.axis), damping="0"
    )
    if joint.limited:
        made.set("range", vector((joint.lower or 0.0, joint.upper or 0.0)))


def _inertial(body: ET.Element, inertial: Any, origin: FloatArray) -> None:
    if inertial is None:
        return
    t = inertial.tensor
    six = (t[0, 0], t[1, 1], t[2, 2], t[0, 1], t[0, 2], t[1, 2])
    ET.SubElement(
        body, "inertial", pos=vector(inertial.center - origin), mass=f"{inertial.mass:.9g}",
        fullinertia=" ".join(f"{v:.9g}" for v in six),
    )  # fmt: skip


def _followers(root: ET.Element, joints: Sequence[Joint]) -> None:
    names = {j.name: k for k, j in enumerate(joints)}
    equal = ET.SubElement(root, "equality")
    for k, joint in enumerate(joints):
        if joint.mimic is not None and joint.mimic.joint in names:
            ET.SubElement(
                equal, "joint", joint1=f"j{k}", joint2=f"j{names[joint.mimic.joint]}",
                polycoef=f"{joint.mimic.offset:.9g} {joint.mimic.multiplier:.9g} 0 0 0",
            )  # fmt: skip


class _Run:
    """The simulation, and what was seen in it."""

    def __init__(self, model: Any, joints: Sequence[Joint]) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self.mujoco, self.model, self.joints = mujoco, model, list(joints)
        self.data = mujoco.MjData(model)
        self.place = np.array([model.joint(f"j{k}").qposadr[0] for k in range(len(joints))])
        self.driven = [k for k, j in enumerate(joints) if j.mimic is None]
        limits = np.array([_limits(j) for j in joints])
        self.low, self.high = limits.T
        self.span = self.high - self.low
        self.slack = np.where([j.rotates for j in joints], 2 * SAG, SAG)
        self.start = np.clip(0.0, self.low, self.high)
        self.exploded: dict[str, str] = {}
        self.drifted: dict[str, float] = {}
        self.missed: dict[str, float] = {}
        self.seconds = 0.0
        self._tune()

    def _tune(self) -> None:
        """Drives as strong as what they carry asks for, critically damped."""
        model = self.model
        for a, k in enumerate(self.driven):
            address = model.joint(f"j{k}").dofadr[0]
            carried = float(model.dof_M0[address])
            stiff, damp = carried * STIFFNESS**2, 2 * carried * STIFFNESS
            model.actuator_gainprm[a, 0] = stiff
            model.actuator_biasprm[a, 1:3] = (-stiff, -damp)

    def _rest(self) -> None:
        self.mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self.place] = self.start
        self.data.ctrl[:] = self.start[self.driven]

    def all_joints(self, gravity: float, progress: Any) -> None:
        """Drive every joint once under ``gravity`` (m/s² along z)."""
        self.model.opt.gravity[:] = (0.0, 0.0, gravity)
        size = math.ceil(len(self.driven) / GROUPS)
        groups = [self.driven[i : i + size] for i in range(0, len(self.driven), size)]
        for n, group in enumerate(groups):
            progress(n / len(groups))
            self._rest()
            self._settle()
            before = self.data.qpos[self.place].copy()
            for end in (self.high, self.low):
                if not self._drive(group, end, before):
                    break

    def _settle(self) -> None:
        self._steps(round(0.1 / STEP), lambda t: None)

    def _drive(self, group: list[int], end: FloatArray, before: FloatArray) -> bool:
        """There and back; False where it exploded."""
        slots = [self.driven.index(k) for k in group]
        way = end - self.start
        if not np.abs(way[group]).max() > 0:
            return True

        def aim(t: float) -> None:
            self.data.ctrl[slots] = self.start[group] + t * way[group]

        count = round(DRIVE / STEP)
        there = self._steps(count, lambda t: aim(0.5 - 0.5 * math.cos(math.pi * min(1.3 * t, 1))))
        if not there:
            return self._burst(group)
        self._compare(group, end)
        back = self._steps(count, lambda t: aim(0.5 + 0.5 * math.cos(math.pi * min(1.3 * t, 1))))
        if not back:
            return self._burst(group)
        self._drift(group, before)
        return True

    def _steps(self, count: int, aim: Any) -> bool:
        """Whether all numbers stayed finite and within reach."""
        for k in range(count):
            aim((k + 1) / count)
            self.mujoco.mj_step(self.model, self.data)
            if k % 20 == 19 and not self._sound():
                return False
        self.seconds += count * STEP
        return self._sound()

    def _sound(self) -> bool:
        bad = self.data.warning[self.mujoco.mjtWarning.mjWARN_BADQACC].number
        return not bad and bool(np.isfinite(self.data.qpos).all()) and not self._outside().any()

    def _outside(self) -> npt.NDArray[np.bool_]:
        q = self.data.qpos[self.place]
        far = np.maximum(self.low - q, q - self.high)
        limited = np.array([j.limited for j in self.joints])
        return limited & (far > OUTSIDE * self.span + self.slack)

    def _burst(self, group: list[int]) -> bool:
        far = np.flatnonzero(self._outside())
        for k in far if len(far) else group:
            self.exploded[self.joints[k].name] = (
                "leaves its limits" if len(far) else "becomes unstable (no finite numbers any more)"
            )
        return False

    def _compare(self, group: list[int], end: FloatArray) -> None:
        q = self.data.qpos[self.place]
        for k in group:
            short = (abs(end[k] - q[k]) - self.slack[k]) / self.span[k]
            if short > MISS:
                self._note(self.missed, k, short)

    def _drift(self, group: list[int], before: FloatArray) -> None:
        q = self.data.qpos[self.place]
        led = {self.joints[k].name for k in group}
        for k, joint in enumerate(self.joints):
            if joint.mimic is not None and joint.mimic.joint in led:
                continue
            share = (abs(q[k] - before[k]) - self.slack[k]) / self.span[k]
            if share > DRIFT:
                self._note(self.drifted, k, share)

    def _note(self, where: dict[str, float], k: int, share: float) -> None:
        name = self.joints[k].name
        where[name] = max(where.get(name, 0.0), float(share))


def _limits(joint: Joint) -> tuple[float, float]:
    if not joint.limited:
        return -math.pi, math.pi
    return joint.lower or 0.0, joint.upper or 0.0
