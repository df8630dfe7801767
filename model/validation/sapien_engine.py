"""SAPIEN as an engine that drives joints: PhysX 5 on the CPU.

As SAPIEN loads a URDF, links that a joint connects don't collide with each other, since PhysX never
lets them. A joint that follows another is driven towards where its leader takes it, since SAPIEN's
tendons couple neighbours alone.
"""

from __future__ import annotations

import importlib
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject, Inertial
from model.core.geometry import affine, x_onto
from model.core.joint import Joint
from model.core.shapes import hull_of_shape
from model.io.urdf.writer import link_origins
from model.physics.simulation_values import Physics
from model.validation.engines import STEP, Drive, FloatArray, Touch

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
