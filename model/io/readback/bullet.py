"""URDF and SDF as PyBullet takes them."""

from __future__ import annotations

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
from scipy.spatial.transform import Rotation

from model.core.articulated_object import ArticulatedObject
from model.core.rotations import affine
from model.io.assets.reload import Poses, object_from_links
from model.io.export.sdf import sdf_tree
from model.io.readback.poses import pose_problems

FloatArray = npt.NDArray[np.float64]


def bullet_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    """Problems when PyBullet loads the file and its joints are set."""
    with _silent():
        return list(dict.fromkeys(_problems(path, obj, settings)))


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


def _problems(path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]) -> list[str]:
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
        index = _links(bullet, bodies[0], client)
        problems: list[str] = []
        for q in settings:
            _set(bullet, bodies[0], client, index, obj, q)
            seen = _poses(bullet, bodies[0], client, index, obj.tree.root)
            problems += pose_problems("PyBullet", object_from_links(obj, q), seen)
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
            elif joint.get("type") == "screw":
                joint.set("type", "revolute")
    with TemporaryDirectory(prefix="artiworld-") as folder:
        for beside in path.parent.iterdir():
            if beside != path:
                Path(folder, beside.name).symlink_to(beside.absolute())
        copy = Path(folder, path.name)
        copy.write_bytes(ElementTree.tostring(root))
        return bullet.loadSDF(str(copy), physicsClientId=client)


def _links(bullet: Any, body: int, client: int) -> dict[str, int]:
    """Link → its number; its joint has the same."""
    out: dict[str, int] = {}
    for i in range(bullet.getNumJoints(body, physicsClientId=client)):
        out[bullet.getJointInfo(body, i, physicsClientId=client)[12].decode()] = i
    return out


def _set(
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


def _poses(bullet: Any, body: int, client: int, index: dict[str, int], root: str) -> Poses:
    """Link → (4, 4) in the root's frame; PyBullet gives the base by its centre of mass."""
    place, turn = bullet.getBasePositionAndOrientation(body, physicsClientId=client)
    inner = bullet.getDynamicsInfo(body, -1, physicsClientId=client)
    world_from_root = _frame(place, turn) @ np.linalg.inv(_frame(inner[3], inner[4]))
    out: Poses = {}
    for link, number in index.items():
        state = bullet.getLinkState(
            body, number, computeForwardKinematics=True, physicsClientId=client
        )
        out[link] = np.linalg.inv(world_from_root) @ _frame(state[4], state[5])
    if root in out:  # an SDF's joint to the world makes a link of the root
        back = np.linalg.inv(out[root])
        return {link: back @ pose for link, pose in out.items()}
    return {**out, root: np.eye(4)}


def _frame(place: Any, turn: Any) -> FloatArray:
    return affine(Rotation.from_quat(turn).as_matrix(), place)
