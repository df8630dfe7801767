"""Runs ``artiworld`` commands on real files."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from unittest import mock

import trimesh

from app.cli.main import main
from tests.builders import box

PROGRAM = Path(sys.executable).with_name("artiworld")


def artiworld(*words: object) -> subprocess.CompletedProcess[str]:
    """Run a command in this process and return its exit code and what it printed."""
    with _redirected(1, "stdout") as out, _redirected(2, "stderr") as err:
        code = main(arguments := [str(word) for word in words])
    return subprocess.CompletedProcess(arguments, code, "".join(out), "".join(err))


def answer(*words: object) -> Any:
    """Run a command that must succeed, and return what it prints as JSON."""
    done = artiworld(*words, "--json")
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def artiworld_process(*words: object) -> subprocess.CompletedProcess[str]:
    """Run the installed program, for tests of what only a process of its own shows."""
    return subprocess.run(
        [str(PROGRAM), *map(str, words)],
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        capture_output=True,
        text=True,
        timeout=120.0,
        check=False,
    )


@contextmanager
def _redirected(descriptor: int, name: str) -> Iterator[list[str]]:
    """Collect what is written to ``sys.<name>`` and, by libraries in C, to its descriptor."""
    text: list[str] = []
    saved = os.dup(descriptor)
    with TemporaryFile() as file, os.fdopen(descriptor, "w", closefd=False) as stream:
        os.dup2(file.fileno(), descriptor)
        try:
            with mock.patch.object(sys, name, stream):
                yield text
        finally:
            stream.flush()
            os.dup2(saved, descriptor)
            os.close(saved)
            file.seek(0)
            text.append(file.read().decode())


def assert_users_mistake(done, *words: str) -> None:
    """Exit code 2 and one line on stderr that holds ``words``."""
    assert done.returncode == 2, done.stderr + done.stdout
    lines = done.stderr.strip().splitlines()
    assert len(lines) == 1, done.stderr
    assert lines[0].startswith("artiworld")
    assert "Traceback" not in lines[0]
    for word in words:
        assert word in lines[0]


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
