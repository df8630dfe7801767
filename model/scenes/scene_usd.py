"""The whole scene as one USD stage, which refers to the assets' own ``usd/object.usdc``."""

from __future__ import annotations

import math
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from model.core.geometry import quaternion_wxyz
from model.io.export.usd import FILE, FRICTION, NAME_KEY, identifier
from model.io.urdf.writer import rounded, xml_name
from model.scenes.jobs import ASSETS
from model.scenes.scene import FloatArray
from model.scenes.scene_xml import Stand


def write_scene_usd(name: str, stands: Sequence[Stand], out: Path, file: str) -> Path:
    """Write ``out/file`` (metres, +z up): a prim a stand below ``/World``.

    Joints that hold a base to the world do so where it stands; a free base has none. Shortened
    limits are opinions of the scene's layer, so equal assets stay one file.

    Args:
        stands: everything in the scene, in order, each with ``usd/`` in its asset's folder.
    """
    usd, geom, physics, gf = (
        import_module(f"pxr.{n}") for n in ("Usd", "UsdGeom", "UsdPhysics", "Gf")
    )
    path = out / file
    draft = path.with_name(f".draft_{file}")
    draft.unlink(missing_ok=True)
    stage: Any = usd.Stage.CreateNew(str(draft))
    geom.SetStageUpAxis(stage, geom.Tokens.z)
    geom.SetStageMetersPerUnit(stage, 1.0)
    physics.SetStageKilogramsPerUnit(stage, 1.0)
    world = geom.Xform.Define(stage, "/World").GetPrim()
    world.SetCustomDataByKey(NAME_KEY, name)
    stage.SetDefaultPrim(world)
    usd.ModelAPI(world).SetKind("assembly")
    taken: set[str] = set()
    prims: dict[str, Any] = {}
    for stand in stands:
        at = f"/World/{identifier(stand.id, taken)}"
        if stand.key is None:
            assert stand.box is not None
            made = geom.Cube.Define(stage, at)
            made.CreateSizeAttr(1.0)
            _stand(gf, made, stand.world_from_asset)
            made.AddScaleOp().Set(gf.Vec3f(*np.asarray(stand.box, float).tolist()))
            physics.CollisionAPI.Apply(made.GetPrim())
        else:
            made = geom.Xform.Define(stage, at)
            made.GetPrim().GetReferences().AddReference(f"./{ASSETS}/{stand.key}/usd/{FILE}")
            _stand(gf, made, stand.world_from_asset)
            _hold(gf, geom, physics, made.GetPrim(), stand)
        made.GetPrim().SetCustomDataByKey(NAME_KEY, stand.id)
        prims[stand.id] = made.GetPrim()
    for stand in stands:
        for found in stand.passes:
            one = _link(prims[stand.id], found.link)
            other = _link(prims[found.through], found.through_link)
            pairs = physics.FilteredPairsAPI.Apply(one).CreateFilteredPairsRel()
            pairs.AddTarget(other.GetPath())
    stage.GetRootLayer().Save()
    del stage
    draft.replace(path)
    return path


def _stand(gf: Any, made: Any, world: FloatArray) -> None:
    made.AddTranslateOp().Set(gf.Vec3d(*rounded(world[:3, 3])))
    double: Any = import_module("pxr.UsdGeom").XformOp.PrecisionDouble
    made.AddOrientOp(double).Set(gf.Quatd(*quaternion_wxyz(world)))


def _link(prim: Any, link: str | None) -> Any:
    """The prim of an object's link; the object's own for a plain box."""
    if link is None:
        return prim
    named = {xml_name(str(p.GetCustomDataByKey(NAME_KEY))): p for p in prim.GetChildren()}
    return named[link]


def _hold(gf: Any, geom: Any, physics: Any, prim: Any, stand: Stand) -> None:
    """Its base to the world, or free, and its limits."""
    held = False
    for joint in list(import_module("pxr.Usd").PrimRange(prim)):
        made = physics.Joint(joint)
        if not made:
            continue
        if not made.GetBody0Rel().GetTargets():
            if stand.free:
                joint.SetActive(False)
            else:
                body = prim.GetStage().GetPrimAtPath(made.GetBody1Rel().GetTargets()[0])
                _pin(gf, geom, made, body)
                held = True
            continue
        friction = stand.friction.get(str(joint.GetCustomDataByKey(NAME_KEY)))
        if friction is not None and joint.HasAttribute(FRICTION):
            joint.GetAttribute(FRICTION).Set(friction)
        limits = stand.limits.get(str(joint.GetCustomDataByKey(NAME_KEY)))
        if limits is not None:
            turns = joint.GetTypeName() == "PhysicsRevoluteJoint"
            unit = 180.0 / math.pi if turns else 1.0
            typed = (physics.RevoluteJoint if turns else physics.PrismaticJoint)(joint)
            typed.CreateLowerLimitAttr(limits[0] * unit)
            typed.CreateUpperLimitAttr(limits[1] * unit)
    if not held and not stand.free:
        made = physics.FixedJoint.Define(prim.GetStage(), f"{prim.GetPath()}/fixed_to_world")
        links = [p for p in prim.GetChildren() if p.HasAPI(physics.RigidBodyAPI)]
        if links:  # the exporter writes the root first
            made.CreateBody1Rel().SetTargets([links[0].GetPath()])
            _pin(gf, geom, made, links[0])


def _pin(gf: Any, geom: Any, joint: Any, body: Any) -> None:
    """The joint's frame in the world is where the body stands."""
    world = np.asarray(geom.XformCache().GetLocalToWorldTransform(body), np.float64).T
    joint.CreateLocalPos0Attr(gf.Vec3f(*world[:3, 3].tolist()))
    joint.CreateLocalRot0Attr(gf.Quatf(*quaternion_wxyz(world)))
    joint.CreateLocalPos1Attr(gf.Vec3f(0, 0, 0))
    joint.CreateLocalRot1Attr(gf.Quatf(1, 0, 0, 0))
