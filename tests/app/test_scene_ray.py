"""``artiworld scene convert --ray``: a Ray cluster on this machine, with a worker killed."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import psutil
import pytest

from app.cli.main import main
from tests.builders import placed
from tests.model.scenes import scenes_made as made

COUNT = 6


def write_scene(folder: Path) -> list[str]:
    objects = [placed(f"cabinet_{i}", "cab", [3 * i, 0, 0], 1 + i / 10) for i in range(COUNT)]
    scene = made.write_scene(folder / "layout.json", made.mesatask(objects))
    assets = made.make_assets(folder / "assets")
    words = f"scene convert {scene} --assets {assets} --out {folder}/out --predictor geometric"
    return [*words.split(), "--ray", "local"]


def busy_worker(pid: int) -> psutil.Process | None:
    """A worker of the cluster that a process began, while it converts."""
    for child in psutil.Process(pid).children(recursive=True):
        with suppress(psutil.NoSuchProcess):
            if "".join(child.cmdline()).startswith("ray::__call__"):
                return child
    return None


def test_a_killed_worker_costs_nothing(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="a cluster needs ray (artiworld[cluster])")
    root = Path(__file__).parents[2]
    environment = {**os.environ, "RAY_DISABLE_IMPORT_WARNING": "1", "RAY_USAGE_STATS_ENABLED": "0"}
    environment["PYTHONPATH"] = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")])
    words = [sys.executable, "-m", "app.cli.main", *write_scene(tmp_path), "--json"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    run = subprocess.Popen(words, cwd=root, env=environment, **pipes)
    try:
        until = time.monotonic() + 240
        while (worker := busy_worker(run.pid)) is None:
            assert run.poll() is None and time.monotonic() < until
            time.sleep(0.01)
        worker.kill()
        out, error = run.communicate(timeout=240)
    finally:
        for child in (
            [*psutil.Process(run.pid).children(recursive=True)] if run.poll() is None else []
        ):
            child.kill()
        run.kill()
    assert run.returncode == 0, error
    summary = json.loads(out)
    assert summary["states"] == {"predicted": COUNT} and summary["assets_converted"] == COUNT
    done = list((tmp_path / "out" / "work" / "assets").glob("*.json"))
    assert len(done) == COUNT and not list((tmp_path / "out" / "assets").glob(".*"))


def test_no_cluster_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ray", reason="a cluster needs ray (artiworld[cluster])")
    words = write_scene(tmp_path)
    words[-1] = "127.0.0.1:1"
    assert main(words) == 2
    assert "127.0.0.1:1" in capsys.readouterr().err
