"""Validators of other projects that are programs: found on the path, run on one file.

``check_urdf`` comes with ROS, ``gz`` with Gazebo. Khronos' glTF-Validator is a library of Node.js:
``npm install --global gltf-validator``, or in the working folder.
"""

from __future__ import annotations

import json
import shutil
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path

from model.core.articulated_object import ArticulatedObject

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
