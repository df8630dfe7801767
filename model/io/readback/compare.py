"""Exported files read back by other people's software, link poses compared with ``pose(q)``."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.io.assets.reload import (
    Poses,
    mujoco_problems,
    object_from_links,
    random_q,
    yourdfpy_problems,
)
from model.io.export.registry import BUILT_IN

TOLERANCE = 1e-5
"""Metres and entries of rotation matrices, in the size of the pose where that is above 1."""

Reader = Callable[[Path, ArticulatedObject, list[dict[str, float]]], list[str]]


@dataclass(frozen=True)
class ReadBack:
    """What came of reading one exported format.

    Attributes:
        format: its name.
        readers: who read it.
        missing: who could have, but isn't installed.
        problems: everything that is wrong.
    """

    format: str
    readers: tuple[str, ...]
    missing: tuple[str, ...]
    problems: tuple[str, ...]

    @property
    def fine(self) -> bool:
        """Whether somebody read it and found nothing wrong."""
        return bool(self.readers) and not self.problems


def read_back(
    format: str, path: Path, obj: ArticulatedObject, *, configurations: int = 3, seed: int = 0
) -> ReadBack:
    """Read ``path``, the first file of an export of ``obj``, with all readers that are installed.

    Args:
        configurations: random joint values to try; joints go beyond their limits too.

    Raises:
        ArtiworldError: for a format that nothing here can check.
    """
    if format not in BUILT_IN:
        raise ArtiworldError(f"nothing here reads the format {format!r} back")
    rng = np.random.default_rng(seed)
    settings = [random_q(obj, rng) for _ in range(configurations)]
    used: list[str] = []
    missing: list[str] = []
    problems: list[str] = []
    for name, module, reader in _readers(format):
        if find_spec(module) is None:
            missing.append(name)
            continue
        used.append(name)
        problems += reader(path, obj, settings)
    return ReadBack(format, tuple(used), tuple(missing), tuple(dict.fromkeys(problems)))


def _readers(format: str) -> list[tuple[str, str, Reader]]:
    """(name, module, function) of those that read a format."""
    from model.io.readback import bullet as readback_bullet
    from model.io.readback import drake as readback_drake
    from model.io.readback import glb as readback_glb
    from model.io.readback import usd as readback_usd

    return {
        "urdf": [
            ("yourdfpy", "yourdfpy", yourdfpy_problems),
            ("MuJoCo", "mujoco", mujoco_problems),
            ("PyBullet", "pybullet", readback_bullet.bullet_problems),
        ],
        "ros": [("yourdfpy", "yourdfpy", _ros_problems)],
        "mjcf": [("MuJoCo", "mujoco", mujoco_problems)],
        "usd": [("usd-core", "pxr", readback_usd.usd_problems)],
        "sdf": [
            ("PyBullet", "pybullet", readback_bullet.bullet_problems),
            ("Drake", "pydrake", readback_drake.drake_problems),
        ],
        "glb": [("pygltflib", "pygltflib", readback_glb.glb_problems)],
    }[format]


def _ros_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    from model.io.export.ros import URDF

    return yourdfpy_problems(path.parent / URDF, obj, settings)


def pose_problems(
    reader: str, expected: Poses, seen: Mapping[str, np.ndarray], tolerance: float = TOLERANCE
) -> list[str]:
    """Links that are elsewhere, or missing."""
    out: list[str] = []
    for link, pose in expected.items():
        if link not in seen:
            out.append(f"{reader} doesn't know the link {link!r}")
            continue
        error = float(np.abs(pose - seen[link]).max())
        scale = max(1.0, float(np.abs(pose).max()))
        if not error <= tolerance * scale:
            shown = "not a number" if math.isnan(error) else f"off by {error:.3g}"
            out.append(f"{reader} puts {link!r} elsewhere, {shown}")
    return out


__all__ = ["TOLERANCE", "ReadBack", "object_from_links", "pose_problems", "read_back"]
