"""Runs the real ``artiworld`` program on real files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import trimesh

PROGRAM = Path(sys.executable).with_name("artiworld")


def artiworld(*words: object, folder: Path | None = None, seconds: float = 120.0, **variables: str):
    """Run it and return the finished process, with text output."""
    environment = {**os.environ, "OMP_NUM_THREADS": "1", **variables}
    return subprocess.run(
        [str(PROGRAM), *map(str, words)],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        timeout=seconds,
        check=False,
    )


def assert_users_mistake(done, *words: str) -> None:
    """Exit code 2 and one line on stderr that holds ``words``."""
    assert done.returncode == 2, done.stderr + done.stdout
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("artiworld")
    assert "Traceback" not in lines[0]
    for word in words:
        assert word in lines[0]


def box(low, high) -> trimesh.Trimesh:
    low, high = np.asarray(low, float), np.asarray(high, float)
    made = trimesh.creation.box(high - low)
    made.apply_translation((low + high) / 2)
    return made


def cupboard() -> list[trimesh.Trimesh]:
    """An open box of five walls with its back at y = 0.5, and a door in front of it, hung left."""
    walls = [
        box((0, 0, 0), (0.6, 0.5, 0.02)),
        box((0, 0, 0.78), (0.6, 0.5, 0.8)),
        box((0, 0, 0.02), (0.02, 0.5, 0.78)),
        box((0.58, 0, 0.02), (0.6, 0.5, 0.78)),
        box((0.02, 0.48, 0.02), (0.58, 0.5, 0.78)),
    ]
    door = [
        box((0.0, -0.02, 0.0), (0.6, -0.002, 0.8)),
        box((0.53, -0.05, 0.35), (0.56, -0.02, 0.45)),
    ]
    return [trimesh.util.concatenate(walls), trimesh.util.concatenate(door)]


DOOR_CLICK = {"position": [0.3, -0.02, 0.6], "part": 1}
HANDLE_CLICK = {"position": [0.545, -0.05, 0.4], "part": 1}
BASE_CLICK = {"position": [0.3, 0.5, 0.4], "part": 0}


def write_prompts(path: Path, value: object) -> Path:
    path.write_text(value if isinstance(value, str) else json.dumps(value))
    return path
