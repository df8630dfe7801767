"""Exported files read back by other people's software, link poses compared with ``pose(q)``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.io.assets.reload import (
    mujoco_problems,
    random_q,
    yourdfpy_problems,
)
from model.io.export.registry import EXPORTERS
from model.io.export.ros import URDF
from model.io.readback.bullet import bullet_problems
from model.io.readback.drake import drake_problems
from model.io.readback.glb import glb_problems
from model.io.readback.usd import usd_problems

Reader = Callable[[Path, ArticulatedObject, list[dict[str, float]]], list[str]]


@dataclass(frozen=True)
class ReadBack:
    """The result of reading one exported format.

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
        """Whether at least one reader read it and none found a problem."""
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
    if format not in EXPORTERS.built_in:
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
    return {
        "urdf": [
            ("yourdfpy", "yourdfpy", yourdfpy_problems),
            ("MuJoCo", "mujoco", mujoco_problems),
            ("PyBullet", "pybullet", bullet_problems),
        ],
        "ros": [("yourdfpy", "yourdfpy", _ros_problems)],
        "mjcf": [("MuJoCo", "mujoco", mujoco_problems)],
        "usd": [("usd-core", "pxr", usd_problems)],
        "sdf": [
            ("PyBullet", "pybullet", bullet_problems),
            ("Drake", "pydrake", drake_problems),
        ],
        "glb": [("pygltflib", "pygltflib", glb_problems)],
    }[format]


def _ros_problems(
    path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]
) -> list[str]:
    return yourdfpy_problems(path.parent / URDF, obj, settings)
