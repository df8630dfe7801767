"""Ctrl+C on commands that work in several processes: they end at once, and nothing stays behind."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

from model.data.registry import DatasetOptions, open_dataset
from model.io.export.urdf import UrdfExporter
from tests.model.prediction.arti4urdf.tiny_qwen3 import write_tiny_qwen3
from tests.model.scenes import scenes_made


def started(*words: str) -> subprocess.Popen[str]:
    """A module that runs in a group of its own."""
    streams = {"stdout": subprocess.DEVNULL, "stderr": subprocess.PIPE, "text": True}
    return subprocess.Popen([sys.executable, "-m", *words], start_new_session=True, **streams)


def in_group(group: int) -> list[int]:
    """Processes of a group, but for those that have ended and that nobody has collected."""
    out = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, group_of = stat.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        if int(group_of) == group and state != "Z":
            out.append(int(stat.parent.name))
    return out


@pytest.mark.parametrize("seconds", [0.0, 1.5])
@pytest.mark.parametrize("command", ["evaluate", "check", "train"])
def test_an_interrupt_ends_all_processes(command: str, seconds: float, tmp_path: Path) -> None:
    jobs = ["--jobs", "2"]
    if command == "evaluate":
        words = ["app.cli.main", command, "--data", "procedural", "--family", "Oven", "--n", "50"]
    elif command == "train":
        skipped = ["edges", "parts", "clouds", "rooms", "moving", "mending"]
        words = ["model.training.segmentation", "--skip", *skipped]
        words, jobs = [*words, "--out", str(tmp_path)], ["--proposals.workers", "2"]
    else:
        data = open_dataset(DatasetOptions("procedural", families=("Oven",), n=8))
        for i in data.ids():
            (tmp_path / i).mkdir()
            UrdfExporter().export(data.load(i).object, tmp_path / i)
        words = ["app.cli.main", command, str(tmp_path), "--no-cache"]
    run = started(*words, *jobs)
    try:
        end = time.monotonic() + 120
        while len(in_group(run.pid)) < 3:
            assert run.poll() is None and time.monotonic() < end, "it never began"
            time.sleep(0.01)
        time.sleep(seconds)
        os.killpg(run.pid, signal.SIGINT)
        ends_quietly(run)
    finally:
        if in_group(run.pid):
            os.killpg(run.pid, signal.SIGKILL)


def test_an_interrupt_does_not_wait_for_a_language_model(tmp_path: Path) -> None:
    """It goes to the command alone, as from a supervisor; the model's process never answers."""
    pytest.importorskip("transformers", reason="transformers is not installed")
    model = write_tiny_qwen3(tmp_path / "qwen3")
    scene = scenes_made.write_scene(tmp_path / "layout.json", scenes_made.mesatask())
    words = f"scene inspect {scene} --finder qwen3:{model} --finder-cache {tmp_path}/cache"
    run = started("app.cli.main", *words.split())
    try:
        end = time.monotonic() + 120
        while not (writing := [p for p in in_group(run.pid) if b"spawn_main" in command_of(p)]):
            assert run.poll() is None and time.monotonic() < end, "it never asked"
            time.sleep(0.01)
        os.kill(writing[0], signal.SIGSTOP)
        os.kill(run.pid, signal.SIGINT)
        ends_quietly(run)
    finally:
        if in_group(run.pid):
            os.killpg(run.pid, signal.SIGKILL)


def test_an_interrupt_does_not_wait_for_a_server_that_is_silent(tmp_path: Path) -> None:
    pytest.importorskip("openai", reason="openai is not installed")
    scene = scenes_made.write_scene(tmp_path / "layout.json", scenes_made.mesatask())
    with socket.create_server(("127.0.0.1", 0)) as server:
        server.settimeout(120)
        words = f"scene inspect {scene} --finder openai:model --finder-cache {tmp_path}/cache"
        url = f"http://127.0.0.1:{server.getsockname()[1]}/v1"
        run = started("app.cli.main", *words.split(), "--finder-url", url)
        try:
            asked, _ = server.accept()
            with asked:
                assert asked.recv(1 << 16)
                os.kill(run.pid, signal.SIGINT)
                ends_quietly(run)
        finally:
            if in_group(run.pid):
                os.killpg(run.pid, signal.SIGKILL)


def ends_quietly(run: subprocess.Popen[str]) -> None:
    """With the code of an interrupt, without a traceback, and with all of its group."""
    _, error = run.communicate(timeout=20)
    assert run.returncode == 130
    assert "Traceback" not in error
    end = time.monotonic() + 5
    while left := in_group(run.pid):
        assert time.monotonic() < end, left
        time.sleep(0.05)


def command_of(process: int) -> bytes:
    """The words that a process was started with; none where it is gone."""
    try:
        return Path(f"/proc/{process}/cmdline").read_bytes()
    except OSError:
        return b""
