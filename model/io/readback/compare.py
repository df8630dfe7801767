"""Exported files read back by other people's software, link poses compared with ``pose(q)``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.io.assets.reload import (
    mujoco_problems,
    random_q,
    yourdfpy_problems,
)
from model.io.export.registry import EXPORTERS, load_exporter, write_object
from model.io.export.ros import URDF
from model.io.export.simready import (
    VALIDATOR,
    AboutPackage,
    SimReadyExporter,
    simready_problems,
    validator_installed,
)
from model.io.readback.bullet import bullet_problems
from model.io.readback.drake import drake_problems
from model.io.readback.glb import glb_problems
from model.io.readback.usd import usd_problems
from model.io.readback.validators import Reader, programs_for
from model.physics.simulation_values import Physics


@dataclass(frozen=True)
class ReadBack:
    """The result of reading one exported format.

    Attributes:
        format: its name.
        readers: who read it.
        missing: who could have, but isn't installed.
        problems: everything that is wrong.
        found: reader → its part of the problems.
    """

    format: str
    readers: tuple[str, ...]
    missing: tuple[str, ...]
    problems: tuple[str, ...]
    found: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def fine(self) -> bool:
        """True if at least one reader read it and none found a problem."""
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
    modules = [(name, find_spec(m) is not None, reader) for name, m, reader in _readers(format)]
    every = [*modules, *programs_for(format)]
    found = {
        name: tuple(dict.fromkeys(reader(path, obj, settings)))
        for name, installed, reader in every if installed
    }  # fmt: skip
    missing = tuple(name for name, installed, _ in every if not installed)
    return ReadBack(format, tuple(found), missing, _all_of(found), found)


def _all_of(found: Mapping[str, tuple[str, ...]]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(p for each in found.values() for p in each))


def write_and_read(obj: ArticulatedObject, physics: Physics, format: str) -> ReadBack:
    """Write ``obj`` in a format and read it back; USD as a SimReady package where NVIDIA's
    validator is installed, which then judges it too."""
    with TemporaryDirectory(prefix="artiworld-") as folder:
        try:
            exporter = load_exporter(format)
            package = format == "usd" and validator_installed()
            if package:
                exporter = SimReadyExporter(AboutPackage("unknown", "unknown"))
            files = write_object(obj, exporter, Path(folder, format), physics=physics)
            back = read_back(format, files[0], obj)
            if package:
                found = {**back.found, VALIDATOR: tuple(simready_problems(files[0]))}
                back = ReadBack(format, tuple(found), back.missing, _all_of(found), found)
        except ArtiworldError as error:
            return ReadBack(format, (), (), (str(error),))
    if not back.readers and not back.problems:
        return replace(back, problems=("none of its readers is installed",))
    return back


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
