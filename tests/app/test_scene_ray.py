"""``artiworld scene convert --ray``: a Ray cluster on this machine, with a worker killed."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import psutil
import pytest

from app.cli.main import main
from tests.builders import placed
from tests.model.scenes import scenes_made as made

COUNT = 6
PLUGIN = '''
import os, time
from pathlib import Path
from model.scenes import jobs

held = Path(os.environ["HELD"])
convert = jobs._convert

def slow(job, out):
    """The first worker that gets here says so and waits to be killed."""
    try:
        with open(held, "x") as file:
            file.write(str(os.getpid()))
    except FileExistsError:
        return convert(job, out)
    time.sleep(600)

jobs._convert = slow
'''
"""Read by each worker as sitecustomize."""


def write_scene(folder: Path) -> list[str]:
    objects = [placed(f"cabinet_{i}", "cab", [3 * i, 0, 0], 1 + i / 10) for i in range(COUNT)]
    scene = made.write_scene(folder / "layout.json", made.mesatask(objects))
    assets = made.make_assets(folder / "assets")
    words = f"scene convert {scene} --assets {assets} --out {folder}/out --predictor geometric"
    return [*words.split(), "--ray", "local"]


def test_a_killed_worker_costs_nothing(tmp_path: Path) -> None:
    pytest.importorskip("ray", reason="a cluster needs ray (artiworld[cluster])")
    (tmp_path / "site").mkdir()
    (tmp_path / "site" / "sitecustomize.py").write_text(
        "import sys\nif any('default_worker' in a for a in sys.orig_argv):\n"
        + "".join(f"    {line}\n" for line in PLUGIN.strip().splitlines())
    )
    held = tmp_path / "held"
    root = Path(__file__).parents[2]
    environment = {**os.environ, "HELD": str(held), "RAY_DISABLE_IMPORT_WARNING": "1"}
    path = f"{tmp_path / 'site'}{os.pathsep}{root}"
    environment |= {"PYTHONPATH": path, "RAY_USAGE_STATS_ENABLED": "0"}
    words = [sys.executable, "-m", "app.cli.main", *write_scene(tmp_path), "--json"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    run = subprocess.Popen(words, cwd=root, env=environment, **pipes)
    try:
        until = time.monotonic() + 240
        while not (held.exists() and held.read_text()) and run.poll() is None:
            assert time.monotonic() < until
            time.sleep(0.1)
        if run.poll() is None:
            pid = int(held.read_text())
            assert psutil.Process(pid).is_running()
            os.kill(pid, signal.SIGKILL)
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
    assert held.exists()  # a worker was killed
    done = list((tmp_path / "out" / "work" / "assets").glob("*.json"))
    assert len(done) == COUNT and not list((tmp_path / "out" / "assets").glob(".*"))


def test_no_cluster_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("ray", reason="a cluster needs ray (artiworld[cluster])")
    words = write_scene(tmp_path)
    words[-1] = "127.0.0.1:1"
    assert main(words) == 2
    assert "127.0.0.1:1" in capsys.readouterr().err
