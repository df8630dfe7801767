"""MuJoCo as an engine that drives joints."""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from typing import Any
from xml.etree import ElementTree as ET  # only writes

import numpy as np

from model.core.articulated_object import ArticulatedObject
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
