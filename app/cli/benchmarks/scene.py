"""``artiworld bench scene``: the time until a large scene appears, on the server.

The scene is procedural: three in ten objects are cabinets in three parts, the others are uneven
blocks. Every object has files and a size of its own, the worst case, as nothing is shared. The
second opening finds the pictures of the first. Nothing is predicted meanwhile.
"""

from __future__ import annotations

import json
import os
import tempfile
import time
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from app.cli.benchmarks.shapes import grid_box
from app.cli.benchmarks.ui import LoopWatch, SimulatedBrowser, wait_for
from app.cli.output import Result, console, table_of
from app.cli.research_commands import BenchCommand
from app.cli.serve import start_server
from app.server.config import ServeConfig
from model.core.geometry import Mesh
from model.core.progress import Progress
from model.io.write import write_mesh

FACES = 2000
"""Triangles of each block, and of each cabinet."""
PICTURE_BYTES = 200_000
"""More than panels and backdrop take; further bytes belong to the scene."""


@dataclass
class SceneFigures:
    """Figures of one opening; milliseconds from the start of the server's work.

    Attributes:
        opening: "first", or "again" with cached pictures.
        first_ms: until any part of the scene was received.
        first_cpu_ms: processor time of the server and its workers until then.
        whole_ms: until every object was sent.
        sent_mb: megabytes sent to the browser.
        memory_mb: peak memory of the server and its worker together, MiB.
        loop_held_ms: longest time that one callback blocked the event loop.
        pick_ms: processor time to find the object under a click, the median of 20.
    """

    opening: str
    objects: int
    first_ms: float = 0.0
    first_cpu_ms: float = 0.0
    whole_ms: float = 0.0
    sent_mb: float = 0.0
    memory_mb: float = 0.0
    loop_held_ms: float = 0.0
    pick_ms: float = 0.0


def bench(options: BenchCommand, _: Progress) -> Result:
    """Measure a first and a second opening of a scene."""
    with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
        root = Path(folder)
        scene = make_scene(root, options.objects)
        figures = [
            _measure(scene, root, options.objects, opening) for opening in ("first", "again")
        ]
    return [asdict(f) for f in figures], lambda: _print(figures)


def make_scene(root: Path, objects: int) -> Path:
    """Write the scene and its assets into ``root``; return the scene's file."""
    rng = np.random.default_rng(0)
    entries: list[dict[str, Any]] = []
    side = int(np.ceil(np.sqrt(objects)))
    for k in range(objects):
        cabinet = k % 10 < 3
        name = f"{'cabinet' if cabinet else 'block'}_{k}"
        place = root / "assets" / name
        place.mkdir(parents=True)
        spans = _CABINET if cabinet else (((0.0, 0.0, 0.0), (0.4, 0.4, 0.4)),)
        for i, (low, high) in enumerate(spans):
            cells = max(2, int(np.sqrt(FACES / len(spans) / 12)))
            box = grid_box(cells, np.add(low, high) / 2, np.subtract(high, low))
            uneven = box.vertices + rng.normal(0, 5e-4, box.vertices.shape)
            write_mesh(Mesh(uneven, box.faces), place / f"link_{i}.obj")
        size = rng.uniform(0.8, 1.2)
        entries.append({
            "id": name, "description": "cabinet" if cabinet else "block", "asset": name,
            "position": [1.2 * (k % side), 1.2 * (k // side), 0.0],
            "quaternion_wxyz": [1, 0, 0, 0], "scale": [size] * 3, "anchor": "base",
        })  # fmt: skip
    path = root / "scene.json"
    path.write_text(json.dumps({"artiworld_scene": 1, "name": "bench", "objects": entries}))
    return path


_CABINET = (
    ((0.0, 0.0, 0.0), (0.6, 0.5, 0.8)),
    ((0.0, -0.02, 0.02), (0.29, 0.0, 0.78)),
    ((0.31, -0.02, 0.02), (0.6, 0.0, 0.78)),
)


def _measure(scene: Path, root: Path, objects: int, opening: str) -> SceneFigures:
    start, used = time.perf_counter(), _cpu(os.getpid())
    config = ServeConfig(
        workspace=root / "workspace", port=0, user="bench", scene=scene, assets=(root / "assets",)
    )
    server = start_server(config)
    try:
        scene_state: Any = server.app_state.scene
        scene_state.paused = True
        browser = SimulatedBrowser(server.url)
        watch = LoopWatch(server.viser.get_event_loop())
        wait_for(lambda: server.apps, "the tab")
        app: Any = next(iter(server.apps.values()))
        figures = SceneFigures(opening, objects)
        picture, least = app.scene.picture, min(PICTURE_BYTES, 10 * FACES * objects)
        wait_for(lambda: picture.nodes and browser.received > least, "the first object")
        figures.first_ms = 1000 * (time.perf_counter() - start)
        worker = server.app_state.workers.geometry.pid
        figures.first_cpu_ms = 1000 * (
            _cpu(os.getpid()) - used + (0.0 if worker is None else _cpu(worker))
        )
        wait_for(
            lambda: len({i for node in picture.nodes for i in node.ids}) == objects,
            "the whole scene",
        )
        figures.sent_mb = browser.quiet() / 1e6
        figures.whole_ms = 1000 * (browser.last - start)
        figures.memory_mb = sum(_peak_memory(p) for p in (os.getpid(), worker) if p)
        figures.loop_held_ms = 1000 * watch.worst
        watch.stop()
        figures.pick_ms = _pick(app, objects)
        browser.close()
        return figures
    finally:
        server.close()


def _cpu(pid: int) -> float:
    """Processor seconds of a process so far."""
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _peak_memory(pid: int) -> float:
    """Peak memory of a process in MiB."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmHWM:"):
            return int(line.split()[1]) / 1024
    return 0.0


def _pick(app: Any, objects: int) -> float:
    picture, rng, taken = app.scene.picture, np.random.default_rng(1), []
    low, high = picture.bounds()
    for _ in range(20):
        target = rng.uniform(low, high)
        origin = target + np.array([3.0, -8.0, 6.0])
        start = time.thread_time()  # the machine may be busy
        picture.pick(origin, (target - origin) / np.linalg.norm(target - origin))
        taken.append(time.thread_time() - start)
    return 1000 * float(np.median(taken))


def _print(figures: list[SceneFigures]) -> None:
    columns = (
        "opening", "objects", "first picture", "processor", "whole scene", "sent", "memory",
        "loop held", "pick",
    )  # fmt: skip
    rows = [
        (
            f.opening, str(f.objects), f"{f.first_ms / 1000:.1f} s",
            f"{f.first_cpu_ms / 1000:.1f} s", f"{f.whole_ms / 1000:.1f} s",
            f"{f.sent_mb:.1f} MB", f"{f.memory_mb:.0f} MiB",
            f"{f.loop_held_ms:.0f} ms", f"{f.pick_ms:.0f} ms",
        )
        for f in figures
    ]  # fmt: skip
    title = "A scene appears, on the server"
    console(140).print(table_of(title, columns, rows, columns[1:]))
