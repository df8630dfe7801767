"""A free-flying parallel gripper in MuJoCo that takes hold of an affordance and moves its joint.

The hand is a free body on a spring with limited force, as the end of a compliant arm is. Nothing
but contact and friction moves the object: joint values are read, never written.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from model.core.articulated_object import Affordance
from model.core.errors import InputFileError
from model.core.geometry import Mesh, quaternion_wxyz
from model.core.shapes import Primitive
from model.io.mjcf_reader import need_mujoco
from model.io.mjcf_source import sites_of
from model.physics.affordances import (
    FINGER,
    FREE_TURN,
    OFF,
    OPENING,
    PALM,
    REACHED,
    SPARE,
    tool_pose,
)

STEP = 0.002
"""Seconds."""
FORCE, TORQUE, GRIP = 150.0, 20.0, 70.0
"""N and N m of the hand, and N of each finger, at most: what a small arm and its gripper have."""
STIFF, TURN_STIFF = 3000.0, 60.0
"""N/m and N m/rad of the springs that hold the hand."""
MASS, INERTIA = 0.8, 0.006
"""kg, kg m² of the hand."""
COM = 0.05
"""Metres from the fingertips back to the hand's centre of mass."""
LEAD, LEAD_TURN = 0.05, 0.35
"""Metres or radians by which the hand's aim is ahead of the link at most."""
SQUEEZE = 0.004
"""Metres by which each finger aims into what it holds; its drive's stiffness makes it a force."""
CONTACT = [0.004, 1.0], [0.95, 0.99, 0.001, 0.5, 2.0]
"""MuJoCo's solref and solimp of the hand: stiffer than the default, as pads hardly give way."""
AWAY = 0.12
"""Metres before the link where the hand starts."""
DEEP = 0.005
"""Metres of penetration between hand and object from which a try counts as failed."""
FAR, LEVER = 1000.0, 0.3
"""Metres where the hand stays while a motor tries; from the hinge, where nothing says a place."""
COME, CLOSE, FOLLOW, WAIT = 0.6, 0.3, 3.0, 2.0
"""Seconds: to the link, to close the fingers, to follow the joint, and longer for slow ones."""

Why = Literal["", "no affordance", "blocked", "slipped", "stuck", "penetration", "unstable"]
Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Try:
    """Result for one affordance.

    Attributes:
        kind: of the affordance. moved: share of the range that was measured at the end.
        deepest: metres of penetration between hand and object. seconds: simulated.
        why: of a failure; "" where the joint reached :data:`~model.physics.affordances.REACHED`.
    """

    kind: str
    moved: float
    deepest: float
    seconds: float
    why: Why = ""


class GripperBench:
    """An exported MJCF, of an object or a scene, with the gripper beside it.

    Raises:
        InputFileError: where MuJoCo refuses the file.
    """

    def __init__(self, path: Path) -> None:
        self._mujoco = mujoco = need_mujoco()
        try:
            spec = mujoco.MjSpec.from_file(str(path))
            _add_gripper(mujoco, spec)
            self.model: Any = spec.compile()
        except (ValueError, OSError) as error:
            said = " ".join(str(error).split())
            raise InputFileError(path, f"MuJoCo can't load it: {said}", "export it again") from None
        self.data: Any = mujoco.MjData(self.model)
        model = self.model
        links = [model.body(k).name for k in range(model.nbody)]
        self.affordances: tuple[Affordance, ...] = tuple(sites_of(model, links))
        self._hand = model.body("robot_hand").id
        self._robot = {model.body(f"robot_{n}").id for n in ("hand", "left", "right")}
        self._free = model.joint("robot_free")
        self._fingers = [model.joint(f"robot_{n}_slide") for n in ("left", "right")]

    def joints(self) -> list[str]:
        """Names of the object's joints that move on their own."""
        model, mujoco = self.model, self._mujoco
        led = {
            int(model.eq_obj1id[k])
            for k in range(model.neq)
            if model.eq_type[k] == int(mujoco.mjtEq.mjEQ_JOINT)
        }
        kinds = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        own = (j for j in range(model.njnt) if model.jnt_type[j] in kinds and j not in led)
        names = [model.joint(j).name for j in own if abs(self.end(j)) > 1e-6]
        return [n for n in names if not n.startswith("robot_")]

    def end(self, joint: int | str) -> float:
        """Target value of the joint, rad or m; see ``opened_range``."""
        j = self.model.joint(joint)
        if not self.model.jnt_limited[j.id]:
            return FREE_TURN
        low, high = j.range
        return float(high if high >= -low else low)

    def open(self, affordance: Affordance, watch: Callable[[Any], None] | None = None) -> Try:
        """Reset the object, take hold, and move the joint.

        Args:
            watch: called with the data after each step, for pictures.
        """
        return _Run(self, affordance, watch).go()

    def jams(self, joint: str) -> bool:
        """True if a motor in the joint, as strong as the hand there, can't move it either."""
        mujoco, model = self._mujoco, self.model
        data, found = mujoco.MjData(model), model.joint(joint)
        data.qpos[self._free.qposadr[0] : self._free.qposadr[0] + 3] = FAR
        most = FORCE
        if int(found.type[0]) == int(mujoco.mjtJoint.mjJNT_HINGE):
            axis = model.jnt_axis[found.id]
            places = [a for a in self.affordances if a.joint == joint]
            arms = (np.linalg.norm(np.cross(a.center, axis)) + a.width / 2 for a in places)
            most *= max(map(float, arms), default=LEVER)
        end, dof = self.end(joint), int(found.dofadr[0])
        for _ in range(round((FOLLOW + WAIT) / STEP)):
            missing = math.copysign(abs(end) / FOLLOW, end) - data.qvel[dof]
            data.qfrc_applied[dof] = np.clip(most * missing / abs(end) * FOLLOW, -most, most)
            mujoco.mj_step(model, data)
            if data.qpos[found.qposadr[0]] / end >= REACHED:
                return False
        return True

    def bodies_from_world(self) -> dict[int, Array]:
        """Body → (4, 4) ``body_from_world`` at rest."""
        data = self._mujoco.MjData(self.model)
        self._mujoco.mj_kinematics(self.model, data)
        turns = data.xmat.reshape(-1, 3, 3).transpose(0, 2, 1)
        return {k: _matrix(r, -r @ data.xpos[k]) for k, r in enumerate(turns)}

    def robot_boxes(self) -> list[tuple[int, Mesh]]:
        """The hand's boxes with their bodies, in the bodies' frames."""
        out: list[tuple[int, Mesh]] = []
        for g in np.flatnonzero(np.isin(self.model.geom_bodyid, list(self._robot))):
            shape = Primitive("box", np.eye(4), tuple(2 * self.model.geom_size[g])).hull
            corners = shape.vertices + self.model.geom_pos[g]
            out.append((int(self.model.geom_bodyid[g]), Mesh(corners, shape.faces)))
        return out

    def opened(self, joint: str) -> float:
        """Share of the way that the joint has moved."""
        return float(self.data.joint(joint).qpos[0]) / self.end(joint)


class _Run:
    """One try."""

    def __init__(
        self, bench: GripperBench, affordance: Affordance, watch: Callable[[Any], None] | None
    ) -> None:
        self._bench, self.model, self.data = bench, bench.model, bench.data
        self.mujoco = bench._mujoco
        self._affordance, self.watch = affordance, watch
        self.joint = self.model.joint(affordance.joint)
        self.body = int(self.model.jnt_bodyid[self.joint.id])
        self.end = bench.end(affordance.joint)
        hinge = int(self.mujoco.mjtJoint.mjJNT_HINGE)
        self.turns = int(self.model.jnt_type[self.joint.id]) == hinge
        self.deepest, self.time = 0.0, 0.0
        self._pinch = affordance.kind in ("grasp", "turn")
        self.parts = {self.body, *(b for b in range(self.model.nbody) if self._below(b))}
        self.start = 0.0

    def _below(self, body: int) -> bool:
        while body:
            body = int(self.model.body_parentid[body])
            if body == self.body:
                return True
        return False

    def go(self) -> Try:
        mujoco, model, data = self.mujoco, self.model, self.data
        mujoco.mj_resetData(model, data)
        link_from_tool = tool_pose(self._affordance, OFF)
        away = np.eye(4)
        away[2, 3] = -AWAY
        mujoco.mj_forward(model, data)
        self._place(self._link(0.0) @ link_from_tool @ away)
        wide = min(self._affordance.width + 2 * SPARE, OPENING) if self._pinch else 0.0
        self._aim_fingers(wide / 2)
        for finger in self._bench._fingers:
            data.qpos[finger.qposadr[0]] = wide / 2  # the robot's own
        for t in self._times(COME):
            away[2, 3] = -AWAY * (1 - t)
            if not self._step(self._link(self._q) @ link_from_tool @ away):
                return self._result("unstable")
        tool = self._link(self._q) @ link_from_tool
        if np.linalg.norm(self.data.xpos[self._bench._hand] - tool[:3, 3]) > 0.012:
            return self._result("blocked")
        if self._pinch:
            shut = max(self._affordance.width / 2 - SQUEEZE, 0.0)
            for t in self._times(CLOSE):
                self._aim_fingers(wide / 2 + (shut - wide / 2) * t)
                if not self._step(tool):
                    return self._result("unstable")
        return self._follow(link_from_tool)

    def _follow(self, link_from_tool: Array) -> Try:
        lever = self._lever(link_from_tool[:3, 3])
        lead = min(LEAD / max(lever, 1e-3), LEAD_TURN) if self.turns else LEAD
        began = self._q
        for t in self._times(FOLLOW + WAIT):
            share = min(t * (FOLLOW + WAIT) / FOLLOW, 1.0)
            ahead = (self.end - began) * share + math.copysign(lead * min(10 * t, 1.0), self.end)
            aim = float(np.clip(began + ahead, self._q - lead, self._q + lead))
            if not self._step(self._link(aim) @ link_from_tool):
                return self._result("unstable")
            if self._bench.opened(self._affordance.joint) >= REACHED:
                return self._result("penetration" if self.deepest > DEEP else "")
        if self.deepest > DEEP:
            return self._result("penetration")
        return self._result("stuck" if self.data.ncon and self._contacts().any() else "slipped")

    def _result(self, why: Why) -> Try:
        moved = self._bench.opened(self._affordance.joint)
        moved = moved if math.isfinite(moved) else 0.0
        return Try(
            self._affordance.kind, round(moved, 3), round(self.deepest, 5), round(self.time, 2), why
        )

    # -- the hand

    @property
    def _q(self) -> float:
        return float(self.data.qpos[self.joint.qposadr[0]])

    def _lever(self, point: Array) -> float:
        axis = self.model.jnt_axis[self.joint.id]
        return float(np.linalg.norm(np.cross(point - self.model.jnt_pos[self.joint.id], axis)))

    def _link(self, q: float) -> Array:
        """(4, 4) where the link would stand at ``q``, with its parent where it is now."""
        model, data, j = self.model, self.data, self.joint.id
        parent = int(model.body_parentid[self.body])
        world = _matrix(data.xmat[parent].reshape(3, 3), data.xpos[parent])
        w, *xyz = model.body_quat[self.body]
        rest = _matrix(Rotation.from_quat([*xyz, w]).as_matrix(), model.body_pos[self.body])
        axis, at = model.jnt_axis[j], model.jnt_pos[j]
        moved = np.eye(4)
        if self.turns:
            moved[:3, :3] = Rotation.from_rotvec(q * axis).as_matrix()
            moved[:3, 3] = at - moved[:3, :3] @ at
        else:
            moved[:3, 3] = q * axis
        return world @ rest @ moved

    def _place(self, pose: Array) -> None:
        at = self._bench._free.qposadr[0]
        self.data.qpos[at : at + 7] = [*pose[:3, 3], *quaternion_wxyz(pose)]
        self.mujoco.mj_forward(self.model, self.data)

    def _aim_fingers(self, each: float) -> None:
        self.data.ctrl[-1] = each

    def _times(self, seconds: float) -> list[float]:
        count = round(seconds / STEP)
        return [(k + 1) / count for k in range(count)]

    def _step(self, pose: Array) -> bool:
        """One step with the hand's springs towards ``pose``; False where it became unstable."""
        data, hand = self.data, self._bench._hand
        here = _matrix(data.xmat[hand].reshape(3, 3), data.xpos[hand])
        at = self._bench._free.dofadr[0]
        turn = data.qvel[at + 3 : at + 6]  # in the body's axes
        spin = here[:3, :3] @ turn
        com = data.xipos[hand]
        velocity = data.qvel[at : at + 3] + np.cross(spin, com - here[:3, 3])
        aim = pose[:3, 3] - pose[:3, 2] * COM
        force = STIFF * (aim - com) - 2 * math.sqrt(STIFF * MASS) * velocity
        error = Rotation.from_matrix(pose[:3, :3] @ here[:3, :3].T).as_rotvec()
        torque = TURN_STIFF * error - 2 * math.sqrt(TURN_STIFF * INERTIA) * spin
        data.xfrc_applied[hand, :3] = _at_most(force, FORCE)
        data.xfrc_applied[hand, 3:] = _at_most(torque, TORQUE)
        self.mujoco.mj_step(self.model, data)
        self.time += STEP
        if self.watch is not None:
            self.watch(data)
        self._measure()
        bad = data.warning[self.mujoco.mjtWarning.mjWARN_BADQACC].number
        return not bad and bool(np.isfinite(data.qpos).all())

    def _contacts(self) -> npt.NDArray[np.bool_]:
        """(C,) whether a contact is between the hand and the object."""
        bodies = self.model.geom_bodyid[self.data.contact.geom]
        robot = np.isin(bodies, list(self._bench._robot))
        return np.asarray(robot.any(axis=1) & ~robot.all(axis=1))

    def _measure(self) -> None:
        if self.data.ncon:
            depth = -self.data.contact.dist[self._contacts()]
            if len(depth):
                self.deepest = max(self.deepest, float(depth.max()))


def _matrix(rotation: Array, shift: Array) -> Array:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = rotation, shift
    return out


def _at_most(vector: Array, most: float) -> Array:
    size = float(np.linalg.norm(vector))
    return vector * (most / size) if size > most else vector


def _add_gripper(mujoco: Any, spec: Any) -> None:
    """Two fingers before a palm, on a free body that weighs nothing against gravity."""
    spec.option.timestep = STEP
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    spec.option.impratio = 10.0
    box, slide = mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtJoint.mjJNT_SLIDE
    hand = spec.worldbody.add_body(
        name="robot_hand",
        gravcomp=1.0,
        mass=MASS - 0.1,
        ipos=[0, 0, -COM],
        inertia=[INERTIA] * 3,
        explicitinertial=True,
    )
    hand.add_freejoint(name="robot_free")
    thick, wide, long = FINGER
    palm = [s / 2 for s in PALM]
    grey = [0.25, 0.27, 0.3, 1.0]
    touch = {
        "solref": CONTACT[0],
        "solimp": CONTACT[1],
        "priority": 1,
        "condim": 4,
        "friction": [1.0, 0.01, 0.0001],
    }
    hand.add_geom(type=box, size=palm, pos=[0, 0, -long - palm[2]], rgba=grey, **touch)
    for name, sign in (("left", 1.0), ("right", -1.0)):
        finger = hand.add_body(name=f"robot_{name}", gravcomp=1.0)
        finger.add_joint(
            name=f"robot_{name}_slide",
            type=slide,
            axis=[sign, 0, 0],
            range=[0, OPENING / 2],
            limited=True,
            damping=20.0,
            armature=0.1,
        )
        finger.add_geom(
            type=box,
            size=[thick / 2, wide / 2, long / 2],
            pos=[sign * thick / 2, 0, -long / 2],
            mass=0.05,
            rgba=grey,
            **touch,
        )
        spec.add_exclude(bodyname1="robot_hand", bodyname2=f"robot_{name}")
    spec.add_exclude(bodyname1="robot_left", bodyname2="robot_right")
    drive = spec.add_actuator(
        name="robot_drive",
        target="robot_left_slide",
        trntype=mujoco.mjtTrn.mjTRN_JOINT,
        forcelimited=True,
        forcerange=[-2 * GRIP, 2 * GRIP],
    )
    drive.set_to_position(kp=40_000.0)
    spec.add_equality(  # one drive moves both fingers, so the hand pulls with either
        type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT,
        name1="robot_right_slide",
        name2="robot_left_slide",
        data=[0.0, 1.0, *[0.0] * 10],
        solref=[0.004, 1],
    )
