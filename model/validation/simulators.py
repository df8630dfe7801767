"""MuJoCo and SAPIEN (PhysX 5 on the CPU) as engines that drive joints.

As SAPIEN loads a URDF, links that a joint connects don't collide with each other, since PhysX never
lets them. A joint that follows another is driven towards where its leader takes it, since SAPIEN's
tendons couple neighbours alone.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET  # only writes

import numpy as np

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.geometry import affine, x_onto
from model.core.joint import Joint
from model.core.shapes import hull_of_shape
from model.io.urdf.writer import link_origins, vector
from model.physics.simulation_values import Physics
from model.validation.engines import STEP, Drive, FloatArray, Touch


class Mujoco:
    """An object in MuJoCo; see :class:`model.validation.engines.Engine`."""

    title = "MuJoCo"

    def __init__(self, obj: ArticulatedObject, joints: Sequence[Joint], physics: Physics) -> None:
        mujoco: Any = importlib.import_module("mujoco")
        self._mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_string(mjcf_text(obj, joints, physics))
        self.data = mujoco.MjData(self.model)
        self._links = list(obj.tree.order)
        count = range(len(joints))
        self._place = np.array([self.model.joint(f"j{k}").qposadr[0] for k in count], int)
        self._driven = [k for k in count if joints[k].mimic is None]

    def set_drives(self, drives: Sequence[Drive]) -> None:
        """Followers hang on their leaders and have none."""
        for a, k in enumerate(self._driven):
            drive = drives[k]
            self.model.actuator_gainprm[a, 0] = drive.stiffness
            self.model.actuator_biasprm[a, 1:3] = (-drive.stiffness, -drive.damping)
            self.model.actuator_forcerange[a] = (-drive.most, drive.most)

    def rest(self, q: FloatArray) -> None:
        """Put the joints at (J,) values."""
        self._mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[self._place] = q
        self.data.ctrl[:] = q[self._driven]

    def set_gravity(self, along_z: float) -> None:
        """In m/s²."""
        self.model.opt.gravity[:] = (0.0, 0.0, along_z)

    def step(self, targets: FloatArray) -> None:
        """One step."""
        self.data.ctrl[:] = targets[self._driven]
        self._mujoco.mj_step(self.model, self.data)

    @property
    def q(self) -> FloatArray:
        """(J,) values."""
        return self.data.qpos[self._place]

    @property
    def force(self) -> FloatArray:
        """(J,) of the drives; 0 for followers."""
        out = np.zeros(len(self._place))
        out[self._driven] = self.data.actuator_force
        return out

    @property
    def stable(self) -> bool:
        """True if MuJoCo warned of no bad acceleration, and all values are finite."""
        bad = self.data.warning[self._mujoco.mjtWarning.mjWARN_BADQACC].number
        return not bad and bool(np.isfinite(self.data.qpos).all())

    def touches(self) -> list[Touch]:
        """Contacts of the last step."""
        contact = self.data.contact
        bodies = self.model.geom_bodyid[contact.geom]  # (C, 2)
        names = [self._links[int(self.model.body(b).name[1:])] if b else "" for b in bodies.flat]
        return [
            Touch(a, b, float(gap), (float(x), float(y), float(z)))
            for a, b, gap, (x, y, z) in zip(
                names[::2], names[1::2], contact.dist, contact.pos, strict=True
            )
        ]


def mjcf_text(obj: ArticulatedObject, joints: Sequence[Joint], physics: Physics) -> str:
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
            ET.SubElement(
                drives, "position", name=f"a{k}", joint=f"j{k}", kp="1", kv="1", forcerange="-1 1"
            )
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
        body,
        "inertial",
        pos=vector(inertial.center - origin),
        mass=f"{inertial.mass:.9g}",
        fullinertia=" ".join(f"{v:.9g}" for v in six),
    )


def _followers(root: ET.Element, joints: Sequence[Joint]) -> None:
    names = {j.name: k for k, j in enumerate(joints)}
    equal = ET.SubElement(root, "equality")
    for k, joint in enumerate(joints):
        if joint.mimic is not None and joint.mimic.joint in names:
            ET.SubElement(
                equal,
                "joint",
                joint1=f"j{k}",
                joint2=f"j{names[joint.mimic.joint]}",
                polycoef=f"{joint.mimic.offset:.9g} {joint.mimic.multiplier:.9g} 0 0 0",
            )


GROUPS = 32
"""Bits of PhysX's ignore groups: pairs of links beyond share the last one."""


class Sapien:
    """An object in SAPIEN; see :class:`model.validation.engines.Engine`."""

    title = "SAPIEN"

    def __init__(self, obj: ArticulatedObject, joints: Sequence[Joint], physics: Physics) -> None:
        with warnings.catch_warnings():  # it draws nothing here, so it needs no Vulkan
            warnings.simplefilter("ignore")
            self._sapien: Any = importlib.import_module("sapien")
        self._physx = self._sapien.physx
        self._joints = joints
        self._system = self._physx.PhysxCpuSystem()
        self._system.timestep = STEP
        self._scene = self._sapien.Scene([self._system])
        self.origins = link_origins(obj.tree)
        self.links: dict[str, Any] = {}
        entities: list[Any] = []
        for link in obj.tree.order:
            entities.append(self._add_link(obj, link, physics))
        for entity in entities:
            self._scene.add_entity(entity)
        root = self.links[obj.tree.root]
        self._whole = root.articulation
        self._whole.root_pose = self._sapien.Pose(self.origins[obj.tree.root])
        self._moved = [self.links[j.child].joint for j in joints]
        order = [j.child_link for j in self._whole.active_joints]
        self._place = np.array([order.index(self.links[j.child]) for j in joints], int)
        names = {j.name: k for k, j in enumerate(joints)}
        self._follow = [
            (k, names[j.mimic.joint], j.mimic)
            for k, j in enumerate(joints)
            if j.mimic is not None and j.mimic.joint in names
        ]
        self._drives: list[Drive] = []
        self._targets = np.zeros(len(joints))
        self._sent = np.full(len(joints), np.nan)

    def _add_link(self, obj: ArticulatedObject, link: str, physics: Physics) -> Any:
        joint = obj.tree.joint_of.get(link)
        parent = None if joint is None else self.links[joint.parent]
        entity = self._sapien.Entity()
        made = self.links[link] = self._physx.PhysxArticulationLinkComponent(parent)
        entity.name = made.name = link
        for shape in physics.collision.get(link, ()):
            made.attach(self._shape(hull_of_shape(shape).vertices - self.origins[link]))
        ignored = 0
        for number, pair in enumerate(physics.overlapping):
            ignored |= (1 << min(number, GROUPS - 1)) if link in pair else 0
        for shape in made.collision_shapes:
            shape.set_collision_groups([1, 1, ignored, 0])
        inertial = physics.inertials.get(link)
        if inertial is not None:
            self._weigh(made, inertial, self.origins[link])
        entity.add_component(made)
        self._connect(made, joint)
        return entity

    def _shape(self, vertices: FloatArray) -> Any:
        try:
            return self._physx.PhysxCollisionShapeConvexMesh(
                vertices.astype(np.float32),
                np.ones(3, np.float32),
                self._physx.get_default_material(),
            )
        except RuntimeError as error:
            raise ValueError(f"PhysX can't cook a hull of {len(vertices)} vertices") from error

    def _weigh(self, made: Any, inertial: Inertial, origin: FloatArray) -> None:
        values, axes = np.linalg.eigh(inertial.tensor)
        axes[:, 0] *= np.linalg.det(axes)  # right-handed
        made.mass = inertial.mass
        made.inertia = np.maximum(values, 0.0)
        made.cmass_local_pose = self._pose(np.asarray(inertial.center) - origin, axes)

    def _pose(self, place: FloatArray, rotation: FloatArray) -> Any:
        return self._sapien.Pose(affine(rotation, place))

    def _connect(self, made: Any, joint: Joint | None) -> None:
        """PhysX's joints turn about x, or slide along it."""
        if joint is None or joint not in self._joints:
            made.joint.type = "fixed"
            if joint is not None:
                at = self.origins[joint.child] - self.origins[joint.parent]
                made.joint.pose_in_parent = self._pose(at, np.eye(3))
            return
        made.joint.name = joint.name
        # Its own "continuous" has no degree of freedom (3.0.3).
        made.joint.type = "revolute_unwrapped" if joint.rotates else "prismatic"
        turned = x_onto(np.asarray(joint.axis))
        at = self.origins[joint.child] - self.origins[joint.parent]
        made.joint.pose_in_parent = self._pose(at, turned)
        made.joint.pose_in_child = self._pose(np.zeros(3), turned)
        ends = joint.motion_range if joint.limited else (-np.inf, np.inf)
        made.joint.limit = np.array(ends, np.float32)

    def set_drives(self, drives: Sequence[Drive]) -> None:
        """Followers get drives without a limit of force."""
        self._drives = list(drives)
        for joint, made, drive in zip(self._joints, self._moved, drives, strict=True):
            most = drive.most if joint.mimic is None else 3e38
            made.set_drive_property(drive.stiffness, drive.damping, most, "force")

    def rest(self, q: FloatArray) -> None:
        """Put the joints at (J,) values."""
        ordered = np.zeros(len(q), np.float32)
        ordered[self._place] = q
        self._whole.qpos = ordered
        self._whole.qvel = np.zeros(len(q), np.float32)
        self._whole.qacc = np.zeros(len(q), np.float32)
        self._aim(q)

    def _aim(self, targets: FloatArray) -> None:
        self._targets = targets.copy()
        if self._follow:
            q = self.q
            for k, leader, mimic in self._follow:
                self._targets[k] = mimic.multiplier * q[leader] + mimic.offset
        for k in np.flatnonzero(self._targets != self._sent).tolist():
            self._moved[k].set_drive_target(float(self._targets[k]))
        self._sent = self._targets

    def set_gravity(self, along_z: float) -> None:
        """In m/s²."""
        self._system.config.gravity = np.array([0.0, 0.0, along_z], np.float32)

    def step(self, targets: FloatArray) -> None:
        """One step."""
        self._aim(targets)
        self._system.step()

    @property
    def q(self) -> FloatArray:
        """(J,) values."""
        return np.asarray(self._whole.qpos, np.float64)[self._place]

    @property
    def force(self) -> FloatArray:
        """(J,) of the drives, by their definition; 0 for followers."""
        speed = np.asarray(self._whole.qvel, np.float64)[self._place]
        away = self._targets - self.q
        out = np.zeros(len(away))
        for k, drive in enumerate(self._drives):
            if self._joints[k].mimic is None:
                pull = drive.stiffness * away[k] - drive.damping * speed[k]
                out[k] = np.clip(pull, -drive.most, drive.most)
        return out

    @property
    def stable(self) -> bool:
        """True if all values are finite."""
        return bool(np.isfinite(self._whole.qpos).all() and np.isfinite(self._whole.qvel).all())

    def touches(self) -> list[Touch]:
        """Contacts of the last step."""
        out: list[Touch] = []
        for contact in self._system.get_contacts():
            a, b = (body.name for body in contact.bodies)
            for point in contact.points:
                x, y, z = map(float, point.position)
                out.append(Touch(a, b, float(point.separation), (x, y, z)))
        return out
