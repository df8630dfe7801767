"""Exported files read back by other people's software, link poses compared with ``pose(q)``.

Validators of other projects are programs, found on the path and run on one file: ``check_urdf``
comes with ROS, ``gz`` with Gazebo. Khronos' glTF-Validator is a library of Node.js:
``npm install --global gltf-validator``, or in the working folder.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ArtiworldError
from model.core.packages import at_place
from model.io.assets.reader import random_q, yourdfpy_problems
from model.io.export.formats import FORMATS
from model.io.export.registry import load_exporter, write_object
from model.io.export.simready import (
    VALIDATOR,
    AboutPackage,
    SimReadyExporter,
    simready_problems,
    validator_installed,
)
from model.io.export.urdf import PACKAGE_URDF
from model.physics.simulation_values import Physics

SECONDS = 120.0
"""Time limit of a program."""
_NODE = """
const fs = require('fs'), path = require('path');
const places = [process.cwd(), ...(process.env.NODE_PATH || '').split(path.delimiter),
                require('child_process').execSync('npm root -g').toString().trim()];
const validator = require(require.resolve('gltf-validator', {paths: places}));
if (process.argv[1]) validator.validateBytes(new Uint8Array(fs.readFileSync(process.argv[1])), {
  externalResourceFunction: (uri) => Promise.reject(new Error(uri)),
}).then((r) => process.stdout.write(JSON.stringify(r.issues)));
"""

Reader = Callable[[Path, ArticulatedObject, list[dict[str, float]]], list[str]]


def check_urdf(path: Path, *_: object) -> list[str]:
    """Problems that ROS' parser of URDF finds."""
    return _refused("check_urdf", ["check_urdf", str(path)])


def gz_sdf(path: Path, *_: object) -> list[str]:
    """Problems that Gazebo's parser of SDF finds."""
    return _refused("gz sdf", ["gz", "sdf", "--check", str(path)])


def gltf_validator(path: Path, *_: object) -> list[str]:
    """Errors that Khronos' validator of glTF finds; its warnings aren't among them."""
    done = _run(["node", "-e", _NODE, str(path)])
    try:
        found = json.loads(done.stdout)["messages"]
    except (ValueError, KeyError):
        return [f"glTF-Validator: {_last(done)}"]
    return [f"glTF-Validator: {m['code']}: {m['message']}" for m in found if m["severity"] == 0]


def programs_for(format: str) -> list[tuple[str, bool, Reader]]:
    """(name, whether it is installed, function) of the programs that check a format."""
    programs: dict[str, list[tuple[str, bool, Reader]]] = {
        "urdf": [("check_urdf", shutil.which("check_urdf") is not None, check_urdf)],
        "sdf": [("gz sdf", shutil.which("gz") is not None, gz_sdf)],
        "glb": [("glTF-Validator", _gltf_installed(), gltf_validator)],
    }
    return programs.get(format, [])


@cache
def _gltf_installed() -> bool:
    if shutil.which("node") is None or shutil.which("npm") is None:
        return False
    return _run(["node", "-e", _NODE]).returncode == 0


def _refused(name: str, command: list[str]) -> list[str]:
    done = _run(command)
    return [] if done.returncode == 0 else [f"{name}: {_last(done)}"]


def _run(command: list[str]) -> subprocess.CompletedProcess[str]:
    try:
        return subprocess.run(
            command, capture_output=True, text=True, timeout=SECONDS, check=False, errors="replace"
        )
    except subprocess.TimeoutExpired:
        return subprocess.CompletedProcess(command, 1, "", f"took more than {SECONDS:.0f} s")


def _last(done: subprocess.CompletedProcess[str]) -> str:
    lines = (done.stderr or done.stdout).strip().splitlines()
    return lines[-1][:300] if lines else "no output"


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
    if format not in FORMATS:
        raise ArtiworldError(f"nothing here reads the format {format!r} back")
    rng = np.random.default_rng(seed)
    settings = [random_q(obj, rng) for _ in range(configurations)]
    every = [
        *((name, find_spec(m) is not None, at_place(p)) for name, m, p in FORMATS[format].readers),
        *programs_for(format),
    ]
    found = {
        name: tuple(dict.fromkeys(reader(path, obj, settings)))
        for name, installed, reader in every
        if installed
    }
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


def ros_problems(path: Path, obj: ArticulatedObject, settings: list[dict[str, float]]) -> list[str]:
    """Problems when yourdfpy loads the URDF of a ROS package."""
    return yourdfpy_problems(path.parent / PACKAGE_URDF, obj, settings)
