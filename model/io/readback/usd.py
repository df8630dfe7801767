"""UsdPhysics as a simulator would take it: bodies, joints, their frames and limits."""

from __future__ import annotations

import math
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.io.assets.reload import object_from_links
from model.io.export.usd import NAME_KEY
from model.io.readback.poses import pose_problems

FloatArray = npt.NDArray[np.float64]


def usd_problems(path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]) -> list[str]:
    """Problems when usd-core opens the file and its joints are moved."""
    Usd, UsdPhysics = import_module("pxr.Usd"), import_module("pxr.UsdPhysics")
    stage = Usd.Stage.Open(str(path))
    if not stage or not stage.GetDefaultPrim():
        return [f"usd-core finds no default prim in {path.name}"]
    reader = _Stage(stage, UsdPhysics)
    problems = reader.problems(obj)
    if problems:
        return problems
    for q in settings:
        seen = reader.poses(obj.tree.root, obj.tree.joint_values(q))
        problems += pose_problems("usd-core", object_from_links(obj, q), seen)
    return list(dict.fromkeys(problems))


class _Stage:
    def __init__(self, stage: Any, physics: Any) -> None:
        geometry = import_module("pxr.UsdGeom")
        self.physics = physics
        self.cache = geometry.XformCache()
        self.body = {
            prim.GetCustomDataByKey(NAME_KEY): prim
            for prim in stage.Traverse() if prim.HasAPI(physics.RigidBodyAPI)
        }  # fmt: skip
        joints = [physics.Joint(p) for p in stage.Traverse() if p.IsA(physics.Joint)]
        self.joints = [j for j in joints if j.GetBody0Rel().GetTargets()]
        self.link_at = {prim.GetPath(): name for name, prim in self.body.items()}
        self.root = stage.GetDefaultPrim()

    def problems(self, obj: ArticulatedObject) -> list[str]:
        out: list[str] = []
        if not self.root.HasAPI(self.physics.ArticulationRootAPI):
            out.append("usd-core: the default prim is no articulation root")
        if set(self.body) != set(obj.tree.links):
            out.append(f"usd-core sees the bodies {', '.join(map(str, self.body))}")
        if len(self.joints) != len(obj.tree.joints):
            out.append(f"usd-core sees {len(self.joints)} joints instead of {len(obj.tree.joints)}")
        for made in self.joints:
            name = made.GetPrim().GetCustomDataByKey(NAME_KEY)
            joint = obj.tree.by_name.get(name)
            if joint is None:
                out.append(f"usd-core sees a joint {name!r}")
            elif joint.limited:
                kind = self.physics.RevoluteJoint if joint.rotates else self.physics.PrismaticJoint
                typed = kind(made.GetPrim())
                unit = 180.0 / math.pi if joint.rotates else 1.0
                seen = (typed.GetLowerLimitAttr().Get(), typed.GetUpperLimitAttr().Get())
                wanted = ((joint.lower or 0.0) * unit, (joint.upper or 0.0) * unit)
                if not np.allclose(seen, wanted, rtol=1e-5, atol=1e-5):
                    out.append(f"usd-core: limits of {name!r} are {seen} instead of {wanted}")
        for link, prim in self.body.items():
            mass = self.physics.MassAPI(prim).GetMassAttr().Get()
            if prim.HasAPI(self.physics.MassAPI) and not (mass and mass > 0):
                out.append(f"usd-core: {link!r} has the mass {mass}")
        return out

    def poses(self, root: str, values: dict[str, float]) -> dict[str, FloatArray]:
        """Link → (4, 4), from the joints' frames alone."""
        out = {root: np.array(self.cache.GetLocalToWorldTransform(self.body[root])).T}
        left = list(self.joints)
        while left:
            ready = [j for j in left if self._end(j.GetBody0Rel()) in out]
            if not ready:
                break
            for joint in ready:
                left.remove(joint)
                name = joint.GetPrim().GetCustomDataByKey(NAME_KEY)
                one = _frame(joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get())
                other = _frame(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get())
                moved = one @ self._motion(joint.GetPrim(), values.get(name, 0.0))
                parent = out[self._end(joint.GetBody0Rel())]
                out[self._end(joint.GetBody1Rel())] = parent @ moved @ np.linalg.inv(other)
        return out

    def _end(self, relation: Any) -> str:
        return self.link_at[relation.GetTargets()[0]]

    def _motion(self, prim: Any, value: float) -> FloatArray:
        """Along or about x, y or z of the joint's frame."""
        out = np.eye(4)
        kind = next((k for k in (self.physics.RevoluteJoint, self.physics.PrismaticJoint)
                     if prim.IsA(k)), None)  # fmt: skip
        if kind is None:
            return out
        axis = "XYZ".index(str(kind(prim).GetAxisAttr().Get()))
        if kind is self.physics.PrismaticJoint:
            out[axis, 3] = value
            return out
        i, j = (axis + 1) % 3, (axis + 2) % 3
        out[i, i] = out[j, j] = math.cos(value)
        out[j, i], out[i, j] = math.sin(value), -math.sin(value)
        return out


def _frame(place: Any, turn: Any) -> FloatArray:
    from scipy.spatial.transform import Rotation

    out = np.eye(4)
    x, y, z = turn.GetImaginary()
    out[:3, :3] = Rotation.from_quat([x, y, z, turn.GetReal()]).as_matrix()
    out[:3, 3] = list(place)
    return out
