"""The joints driven there and back in MuJoCo, without gravity and with it."""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET  # only writes

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.display_names import display_name
from model.core.installing import install_command
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.core.shapes import hull_of_shape
from model.io.urdf.writer import link_origins, vector
from model.physics.simulation_values import Physics, rough_physics
from model.validation import messages
from model.validation.drives import DRIFT, OUTSIDE, Bounds, DriveCache, DriveResult, drive_cache
from model.validation.messages import value
from model.validation.physics_report import PhysicsReport, Stop

STEP = 0.002
"""Seconds."""
DRIVE = 0.4
"""Seconds to one end of a range; as many back."""
STIFFNESS = 100.0
"""1/s: natural frequency of the position drives, which are critically damped for their load."""
GROUPS = 12
"""Most drives of an object: joints of larger ones are driven several at a time."""
SAG = 2 * 9.81 / STIFFNESS**2
"""Metres that a drive yields under twice its load; the same in radians on a lever of a metre."""
MISS = 0.1
"""Share of the range short of its target from which a joint is reported."""
HASTE = 0.5 * (1.3 * math.pi / DRIVE) ** 2
"""1/s²: greatest acceleration along the path, over its length."""
SPARE = 4.0
"""Force limit of a drive over what path and weight need, so that obstacles are not torn out."""
TOUCHING = 1e-3
"""Metres of gap up to which a shape counts as the one that stops a joint."""

FloatArray = npt.NDArray[np.float64]


def run_physics(
    obj: ArticulatedObject,
    physics: Physics | None = None,
    *,
    progress: Progress = no_progress,
) -> PhysicsReport:
    """Drive each joint to both ends of its range and back while the others hold still.

    Args:
        physics: with it the links collide as in an exported asset; None drives joints with rough
            masses alone, which is quick.
    """
    if not simulator_installed():
        command = install_command("artiworld[physics]")
        return PhysicsReport(False, messages.NOT_INSTALLED.format(command=command))
    mujoco: Any = importlib.import_module("mujoco")
    joints = [j for j in obj.tree.joints if _drivable(j)]
    physics = physics or rough_physics(obj)
    shapes = sum(map(len, physics.collision.values()))
    if not joints:
        return PhysicsReport(True, shapes=shapes)
    text = _xml(obj, joints, physics)
    try:
        model = mujoco.MjModel.from_xml_string(text)
    except ValueError as error:
        return PhysicsReport(False, messages.NOT_LOADED.format(error=str(error)[:200]))
    run = Simulation(model, joints, obj, drive_cache(text, obj))
    for k, gravity in enumerate((0.0, -9.81)):
        run.all_joints(gravity, lambda f, k=k: progress(0.5 * (k + f), messages.SIMULATING))
    return PhysicsReport(
        True, "", run.exploded, run.drifted, run.missed, shapes, run.seconds, run.stops
    )


def simulator_installed() -> bool:
    """Whether MuJoCo (``artiworld[physics]``) is installed."""
    return importlib.util.find_spec("mujoco") is not None


def _drivable(joint: Joint) -> bool:
    if not joint.moves:
        return False
    return not joint.limited or (joint.upper or 0.0) - (joint.lower or 0.0) > 1e-6


def _xml(obj: ArticulatedObject, joints: Sequence[Joint], physics: Physics) -> str:
    """The object with its base fixed to the world; names are numbers of links and joints."""
    root = ET.Element("mujoco")
    ET.SubElement(root, "compiler", angle="radian", autolimits="true", balanceinertia="true")
    ET.SubElement(root, "option", timestep=str(STEP), integrator="implicitfast")
    assets = ET.SubElement(root, "asset")
    world = ET.SubElement(root, "worldbody")
    tree, inertials, origins = obj.tree, physics.inertials, link_origins(obj.tree)
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
        for k, shape in enumerate(physics.collision.get(link, ())):
            name = f"m{number[link]}_{k}"
            corners = hull_of_shape(shape).vertices - origins[link]
            flat = " ".join(f"{v:.9g}" for v in corners.ravel())
            ET.SubElement(assets, "mesh", name=name, vertex=flat)
            ET.SubElement(body, "geom", type="mesh", mesh=name, mass="0")
    contact = ET.SubElement(root, "contact")
    for a, b in physics.overlapping:
        ET.SubElement(contact, "exclude", body1=f"b{number[a]}", body2=f"b{number[b]}")
    _followers(root, joints)
    drives = ET.SubElement(root, "actuator")
    for k, joint in enumerate(joints):
        if joint.mimic is None:
            ET.SubElement(drives, "position", name=f"a{k}", joint=f"j{k}", kp="1", kv="1",
                          forcerange="-1 1")  # fmt: skip
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


class Simulation:
    """The simulation and its results so far."""

    def __init__(
        self, model: Any, joints: Sequence[Joint], obj: ArticulatedObject, cache: DriveCache
    ) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self.mujoco, self.model, self.joints = mujoco, model, list(joints)
        self.data = mujoco.MjData(model)
        self.place = np.array([model.joint(f"j{k}").qposadr[0] for k in range(len(joints))])
        self.driven = [k for k, j in enumerate(joints) if j.mimic is None]
        limits = np.array([j.motion_range for j in joints])
        self.low, self.high = limits.T
        self.span = self.high - self.low
        self.slack = np.where([j.rotates for j in joints], 2 * SAG, SAG)
        self.start = np.clip(0.0, self.low, self.high)
        self.exploded: dict[str, str] = {}
        self.drifted: dict[str, float] = {}
        self.missed: dict[str, float] = {}
        self.stops: dict[str, Stop] = {}
        self.obj, self.links = obj, list(obj.tree.order)
        self.seconds = 0.0
        self.most = np.full(len(self.driven), np.inf)
        self._cache = cache
        self._result = DriveResult.empty(len(joints), len(self.driven))
        self._tune()

    def _tune(self) -> None:
        """Make each drive as strong as its load needs, critically damped."""
        model, data = self.model, self.data
        self.mujoco.mj_forward(model, data)
        for a, k in enumerate(self.driven):
            address = model.joint(f"j{k}").dofadr[0]
            carried = float(model.dof_M0[address])
            stiff, damp = carried * STIFFNESS**2, 2 * carried * STIFFNESS
            model.actuator_gainprm[a, 0] = stiff
            model.actuator_biasprm[a, 1:3] = (-stiff, -damp)
            body = model.joint(f"j{k}").bodyid[0]
            lever = 1.0
            if self.joints[k].rotates:
                arm = data.subtree_com[body] - data.xpos[body]
                lever = float(np.linalg.norm(np.cross(arm, self.joints[k].axis)))
            weight = 9.81 * float(model.body_subtreemass[body]) * lever
            most = SPARE * (weight + carried * HASTE * float(self.span[k]))
            model.actuator_forcerange[a] = (-most, most)
            self.most[a] = most

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
            bounds = Bounds(self.low, self.high, self.most)
            result = self._cache.load(gravity, group, bounds, self.driven)
            if result is None:
                result = self._result = DriveResult.empty(len(self.joints), len(self.driven))
                self._rest()
                self._settle()
                before = self.data.qpos[self.place].copy()
                for end in (self.high, self.low):
                    if not self.drive(group, end, before):
                        break
                self._cache.save(gravity, group, bounds, result)
            self._add(result)

    def _add(self, result: DriveResult) -> None:
        """Merge one drive: the worst of each joint counts."""
        self.seconds += result.seconds
        for k, share, stop in result.missed:
            name = self.joints[k].name
            if share > self.missed.get(name, 0.0):
                self.missed[name], self.stops[name] = share, stop
        for k, share in result.drifted:
            name = self.joints[k].name
            self.drifted[name] = max(self.drifted.get(name, 0.0), share)
        for k, how, place in result.exploded:
            name = self.joints[k].name
            self.exploded[name] = how
            if place is not None:
                self.stops[name] = place

    def _settle(self) -> None:
        self._steps(round(0.1 / STEP), lambda t: None)

    def drive(self, group: list[int], end: FloatArray, before: FloatArray) -> bool:
        """There and back; False where it exploded."""
        slots = [self.driven.index(k) for k in group]
        path = end - self.start
        if not np.abs(path[group]).max() > 0:
            return True

        def aim(t: float) -> None:
            self.data.ctrl[slots] = self.start[group] + t * path[group]

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
        """Simulate; False where a value became infinite or far outside its limits."""
        for k in range(count):
            aim((k + 1) / count)
            self.mujoco.mj_step(self.model, self.data)
            self._result.record(self.data.qpos[self.place], self.data.actuator_force)
            if k % 20 == 19 and not self._is_stable():
                return False
        self._result.seconds += count * STEP
        return self._is_stable()

    def _is_stable(self) -> bool:
        bad = self.data.warning[self.mujoco.mjtWarning.mjWARN_BADQACC].number
        return not bad and bool(np.isfinite(self.data.qpos).all()) and not self._outside().any()

    def _outside(self) -> npt.NDArray[np.bool_]:
        q = self.data.qpos[self.place]
        far = np.maximum(self.low - q, q - self.high)
        limited = np.array([j.limited for j in self.joints])
        return limited & (far > OUTSIDE * self.span + self.slack)

    def _burst(self, group: list[int]) -> bool:
        far = np.flatnonzero(self._outside())
        for k in far.tolist():
            stop = self._stop(k)
            self._result.exploded.append((k, self._left(k, group, stop), stop))
        for k in group if not len(far) else ():
            self._result.exploded.append((k, messages.UNSTABLE, None))
        return False

    def _left(self, k: int, group: list[int], stop: Stop) -> str:
        """Say how far a joint is beyond its limits, which joint was driven, and what pushes it."""
        joint, q = self.joints[k], float(self.data.qpos[self.place[k]])
        beyond = max(float(self.low[k]) - q, q - float(self.high[k]))
        by = messages.BY.format(value=value(joint, beyond)) if math.isfinite(beyond) else ""
        others = [display_name(self.obj, self.joints[g].child) for g in group if g != k]
        template = (messages.DRIVEN_ITSELF, messages.DRIVEN_ONE, messages.DRIVEN_TWO,
                    messages.DRIVEN_MANY)[min(len(others), 3)]  # fmt: skip
        driven = template.format(**dict(zip(("first", "second"), others, strict=False)))
        cause = ""
        if joint.mimic is not None:
            cause = messages.CAUSE_MIMIC
        elif stop.other is not None:
            cause = messages.CAUSE_SHAPES.format(other=display_name(self.obj, stop.other))
        return messages.LEAVES_LIMITS.format(by=by, driven=driven, cause=cause)

    def _compare(self, group: list[int], end: FloatArray) -> None:
        q = self.data.qpos[self.place]
        for k in group:
            short = (abs(end[k] - q[k]) - self.slack[k]) / self.span[k]
            if short > MISS:
                self._result.missed.append((k, float(short), self._stop(k)))

    def _stop(self, k: int) -> Stop:
        """Where a joint is, and which other link touches its subtree."""
        model, data = self.model, self.data
        moved = np.zeros(model.nbody, bool)
        moved[model.joint(f"j{k}").bodyid[0]] = True
        for body in range(1, model.nbody):  # parents come first
            moved[body] |= moved[model.body_parentid[body]]
        contact = data.contact
        bodies = model.geom_bodyid[contact.geom]  # (C, 2)
        across = moved[bodies[:, 0]] != moved[bodies[:, 1]]
        near = np.flatnonzero(across & (contact.dist < TOUCHING))
        other, where = None, None
        if len(near):
            first = near[contact.dist[near].argmin()]
            hit = bodies[first][0 if moved[bodies[first][1]] else 1]
            other = self.links[int(model.body(hit).name[1:])]
            where = tuple(float(v) for v in contact.pos[first])
        q = {j.name: float(v) for j, v in zip(self.joints, data.qpos[self.place], strict=True)}
        name = self.joints[k].name
        return Stop({name: q[name]}, other, where)  # type: ignore[arg-type]

    def _drift(self, group: list[int], before: FloatArray) -> None:
        q = self.data.qpos[self.place]
        self._result.moved = np.maximum(self._result.moved, np.abs(q - before) - self.slack)
        led = {self.joints[k].name for k in group}
        for k, joint in enumerate(self.joints):
            if joint.mimic is not None and joint.mimic.joint in led:
                continue
            share = (abs(q[k] - before[k]) - self.slack[k]) / self.span[k]
            if share > DRIFT:
                self._result.drifted.append((k, float(share)))
