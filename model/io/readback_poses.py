"""Link poses of exported files as other software has them, compared with ours.

PyBullet takes URDF and SDF. Drake takes SDF, its reader is libsdformat, Gazebo's own. An animated
GLB is played as by a viewer, which interpolates between keyframes. UsdPhysics is taken as by a
simulator: bodies, joints, their frames and limits.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from model.core.articulated_object import ArticulatedObject
from model.core.geometry import affine
from model.core.joint import JOINT_KINDS
from model.io.assets.reader import Poses, object_from_links, pose_problems
from model.io.export.glb import joint_track
from model.io.export.sdf import sdf_joint_names, sdf_tree
from model.io.export.usd import NAME_KEY

TOLERANCE = 1e-5
"""Of poses in single precision, see :func:`~model.io.assets.reader.pose_problems`."""
FloatArray = npt.NDArray[np.float64]


def bullet_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when PyBullet loads the file and its joints are set."""
    with _silent():
        return list(dict.fromkeys(_load_and_set(path, obj, settings)))


@contextmanager
def _silent() -> Iterator[None]:
    """PyBullet prints from C, past Python's own streams."""
    sys.stdout.flush()
    kept = [os.dup(1), os.dup(2)]
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 1)
        os.dup2(nowhere, 2)
        yield
    finally:
        for number, saved in enumerate(kept, start=1):
            os.dup2(saved, number)
            os.close(saved)
        os.close(nowhere)


def _load_and_set(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    bullet: Any = import_module("pybullet")
    client = bullet.connect(bullet.DIRECT)
    try:
        if path.suffix == ".sdf":
            tree, pitches = sdf_tree(obj)
            obj = replace(obj, tree=tree)
            settings = [{**q, **dict.fromkeys(pitches, 0.0)} for q in settings]
            bodies = _load_sdf(bullet, path, client)
        else:
            bodies = [bullet.loadURDF(str(path), useFixedBase=True, physicsClientId=client)]
        if len(bodies) != 1:
            return [f"PyBullet sees {len(bodies)} bodies in {path.name} instead of one"]
        index = _bullet_links(bullet, bodies[0], client)
        problems: list[str] = []
        for q in settings:
            _set_joints(bullet, bodies[0], client, index, obj, q)
            seen = _bullet_poses(bullet, bodies[0], client, index, obj.tree.root)
            problems += pose_problems("PyBullet", object_from_links(obj, q), seen, TOLERANCE)
        return problems
    except bullet.error as error:
        return [f"PyBullet can't load {path.name}: {error}"]
    finally:
        bullet.disconnect(client)


def _load_sdf(bullet: Any, path: Path, client: int) -> Any:
    """PyBullet knows neither a joint to the world nor screws. It reads a copy without the one and
    with hinges for the others, which are the same where they aren't turned."""
    from defusedxml import ElementTree

    root = ElementTree.fromstring(path.read_bytes())
    for model in root.findall("model"):
        for joint in model.findall("joint"):
            if joint.findtext("parent") == "world":
                model.remove(joint)
            elif joint.get("type") not in JOINT_KINDS:  # a screw
                joint.set("type", "revolute")
    with TemporaryDirectory(prefix="artiworld-") as folder:
        for beside in path.parent.iterdir():
            if beside != path:
                Path(folder, beside.name).symlink_to(beside.absolute())
        copy = Path(folder, path.name)
        copy.write_bytes(ElementTree.tostring(root))
        return bullet.loadSDF(str(copy), physicsClientId=client)


def _bullet_links(bullet: Any, body: int, client: int) -> dict[str, int]:
    """Link → its number; its joint has the same."""
    out: dict[str, int] = {}
    for i in range(bullet.getNumJoints(body, physicsClientId=client)):
        out[bullet.getJointInfo(body, i, physicsClientId=client)[12].decode()] = i
    return out


def _set_joints(
    bullet: Any,
    body: int,
    client: int,
    index: dict[str, int],
    obj: ArticulatedObject,
    q: dict[str, float],
) -> None:
    for name, value in obj.tree.joint_values(q).items():
        child = obj.tree.by_name[name].child
        if child in index:
            bullet.resetJointState(body, index[child], value, physicsClientId=client)


def _bullet_poses(bullet: Any, body: int, client: int, index: dict[str, int], root: str) -> Poses:
    """Link → (4, 4) in the root's frame; PyBullet gives the base by its centre of mass."""
    place, turn = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
    inner = bullet.getDynamicsInfo(body, -1, physicsClientId=client)
    world_from_root = _bullet_frame(place, turn) @ np.linalg.inv(_bullet_frame(inner[3], inner[4]))
    out: Poses = {}
    for link, number in index.items():
        state = bullet.getLinkState(
            body, number, computeForwardKinematics=True, physicsClientId=client
        )
        out[link] = np.linalg.inv(world_from_root) @ _bullet_frame(state[4], state[5])
    if root in out:  # an SDF's joint to the world makes a link of the root
        back = np.linalg.inv(out[root])
        return {link: back @ pose for link, pose in out.items()}
    return {**out, root: np.eye(4)}


def _bullet_frame(place: Any, turn: Any) -> FloatArray:
    return affine(Rotation.from_quat(turn).as_matrix(), place)


def drake_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when Drake parses the file and its joints are set."""
    plant_module: Any = import_module("pydrake.multibody.plant")
    parsing: Any = import_module("pydrake.multibody.parsing")
    plant = plant_module.MultibodyPlant(0.0)
    try:
        (model,) = parsing.Parser(plant).AddModels(str(path))
        plant.Finalize()
    except (RuntimeError, ValueError) as error:
        return [f"Drake can't load {path.name}: {' '.join(str(error).split())[:300]}"]
    tree, pitches = sdf_tree(obj)
    names = sdf_joint_names(tree)
    context = plant.CreateDefaultContext()
    problems: list[str] = []
    for q in settings:
        for name, value in tree.joint_values(q).items():
            joint = plant.GetJointByName(names[name], model)
            if name in pitches:
                joint.set_translation(context, pitches[name] * value / (2 * math.pi))
            elif tree.by_name[name].rotates:
                joint.set_angle(context, value)
            else:
                joint.set_translation(context, value)
        frames = {link: plant.GetBodyByName(link, model) for link in tree.links}
        root = frames[obj.tree.root].EvalPoseInWorld(context).inverse()
        seen = {
            link: (root @ body.EvalPoseInWorld(context)).GetAsMatrix4()
            for link, body in frames.items()
        }
        expected = {k: v for k, v in object_from_links(obj, q).items() if k in frames}
        problems += pose_problems("Drake", expected, seen, TOLERANCE)
    return list(dict.fromkeys(problems))


_OBJECT_FROM_GLTF = np.array([[1, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1.0]])


def glb_problems(path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]) -> list[str]:
    """Problems when pygltflib opens the file and its first animation is played.

    A viewer has no joint values, so each of the ``settings`` stands for a moment instead: its
    number of moments, spread over the animation.
    """
    gltf = import_module("pygltflib").GLTF2().load_binary(str(path))
    leaders = [j for j in obj.tree.joints if j.moves and j.mimic is None]
    problems: list[str] = []
    if leaders and not gltf.animations:
        return ["pygltflib sees no animation"]
    binary = gltf.binary_blob()
    moments = np.linspace(0.07, 0.93, max(len(settings), 1)) if leaders else np.zeros(1)
    for moment in moments:
        tracks = {j.name: joint_track(j) for j in leaders}
        q = {n: float(np.interp(moment, np.linspace(0, 1, len(t)), t)) for n, t in tracks.items()}
        seen = _glb_poses(gltf, binary, float(moment))
        problems += pose_problems("pygltflib", object_from_links(obj, q), seen, 2e-5)
    return list(dict.fromkeys(problems))


def _glb_poses(gltf: Any, binary: bytes, moment: float) -> dict[str, FloatArray]:
    """Node name → (4, 4) with z up, ``moment`` (0..1) into the first animation."""
    local = [_node_pose(node) for node in gltf.nodes]
    for animation in gltf.animations[:1]:
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            times = _accessor(gltf, binary, sampler.input)[:, 0]
            keys = _accessor(gltf, binary, sampler.output)
            now, node = moment * float(times[-1]), channel.target.node
            if channel.target.path == "rotation":
                local[node][:3, :3] = Slerp(times, Rotation.from_quat(keys))(now).as_matrix()
            else:
                local[node][:3, 3] = [np.interp(now, times, column) for column in keys.T]
    out: dict[str, FloatArray] = {}
    stack = [(i, _OBJECT_FROM_GLTF) for i in gltf.scenes[gltf.scene or 0].nodes]
    while stack:
        index, above = stack.pop()
        pose = above @ local[index]
        out[gltf.nodes[index].name] = pose
        stack += [(child, pose) for child in gltf.nodes[index].children or []]
    return out


def _node_pose(node: Any) -> FloatArray:
    turn = Rotation.from_quat(node.rotation or [0, 0, 0, 1]).as_matrix()
    return affine(turn, node.translation or None)


def _accessor(gltf: Any, binary: bytes, index: int) -> FloatArray:
    accessor = gltf.accessors[index]
    view = gltf.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    flat = np.frombuffer(binary, "<f4", accessor.count * width, start)
    return flat.reshape(-1, width).astype(np.float64)


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
        problems += pose_problems("usd-core", object_from_links(obj, q), seen, TOLERANCE)
    return list(dict.fromkeys(problems))


class _Stage:
    def __init__(self, stage: Any, physics: Any) -> None:
        geometry = import_module("pxr.UsdGeom")
        self.physics = physics
        self.cache = geometry.XformCache()
        self.body = {
            prim.GetCustomDataByKey(NAME_KEY): prim
            for prim in stage.Traverse()
            if prim.HasAPI(physics.RigidBodyAPI)
        }
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
                one = _usd_frame(joint.GetLocalPos0Attr().Get(), joint.GetLocalRot0Attr().Get())
                other = _usd_frame(joint.GetLocalPos1Attr().Get(), joint.GetLocalRot1Attr().Get())
                moved = one @ self._motion(joint.GetPrim(), values.get(name, 0.0))
                parent = out[self._end(joint.GetBody0Rel())]
                out[self._end(joint.GetBody1Rel())] = parent @ moved @ np.linalg.inv(other)
        return out

    def _end(self, relation: Any) -> str:
        return self.link_at[relation.GetTargets()[0]]

    def _motion(self, prim: Any, value: float) -> FloatArray:
        """Along or about x, y or z of the joint's frame."""
        for kind in (self.physics.RevoluteJoint, self.physics.PrismaticJoint):
            if prim.IsA(kind):
                way = value * np.eye(3)["XYZ".index(str(kind(prim).GetAxisAttr().Get()))]
                turns = kind is self.physics.RevoluteJoint
                return affine(Rotation.from_rotvec(way).as_matrix()) if turns else affine(None, way)
        return np.eye(4)


def _usd_frame(place: Any, turn: Any) -> FloatArray:
    xyzw = [*turn.GetImaginary(), turn.GetReal()]
    return affine(Rotation.from_quat(xyzw).as_matrix(), list(place))
