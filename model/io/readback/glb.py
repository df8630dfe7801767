"""Animated GLB as a viewer plays it: keyframes between which it interpolates."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation, Slerp

from model.core.articulated_object import ArticulatedObject
from model.io.assets.reload import object_from_links
from model.io.export.glb import joint_track
from model.io.readback.poses import pose_problems

FloatArray = npt.NDArray[np.float64]

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
        seen = _poses(gltf, binary, float(moment))
        problems += pose_problems("pygltflib", object_from_links(obj, q), seen, 2e-5)
    return list(dict.fromkeys(problems))


def _poses(gltf: Any, binary: bytes, moment: float) -> dict[str, FloatArray]:
    """Node name → (4, 4) with z up, ``moment`` (0..1) into the first animation."""
    local = [_local(node) for node in gltf.nodes]
    for animation in gltf.animations[:1]:
        for channel in animation.channels:
            sampler = animation.samplers[channel.sampler]
            times = _array(gltf, binary, sampler.input)[:, 0]
            keys = _array(gltf, binary, sampler.output)
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


def _local(node: Any) -> FloatArray:
    out = np.eye(4)
    if node.rotation:
        out[:3, :3] = Rotation.from_quat(node.rotation).as_matrix()
    if node.translation:
        out[:3, 3] = node.translation
    return out


def _array(gltf: Any, binary: bytes, index: int) -> FloatArray:
    accessor = gltf.accessors[index]
    view = gltf.bufferViews[accessor.bufferView]
    width = {"SCALAR": 1, "VEC3": 3, "VEC4": 4}[accessor.type]
    start = (view.byteOffset or 0) + (accessor.byteOffset or 0)
    flat = np.frombuffer(binary, "<f4", accessor.count * width, start)
    return flat.reshape(-1, width).astype(np.float64)
