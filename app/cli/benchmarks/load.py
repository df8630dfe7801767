"""``artiworld bench scene`` and ``team``: the time until a large scene appears, and many people who
work through the REST API at one server.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from app.cli.bench_commands import SceneBench, TeamBench
from app.cli.benchmarks.shapes import grid_box
from app.cli.benchmarks.ui import (
    MOST_PROMPTS,
    PAUSE,
    LoopWatch,
    SimulatedBrowser,
    cabinet_cloud,
    drawer_ray,
    wait_for,
    waiting_times,
)
from app.cli.output import Result, print_figures, print_records
from app.cli.serve import start_server
from app.client import ApiError, Client
from app.server.config import ServeConfig
from app.server.network import free_port
from model.core.geometry import Mesh
from model.core.memory import processor_seconds
from model.core.progress import Progress
from model.io.write import write_cloud, write_mesh
from sessions.store import Store

FACES = 2000
"""Triangles of each block, and of each cabinet."""
PICTURE_BYTES = 200_000
"""More than panels and backdrop take; further bytes belong to the scene."""


def scene_bench(options: SceneBench, _: Progress) -> Result:
    """Measure a first and a second opening of a scene."""
    with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
        root = Path(folder)
        scene = make_scene(root, options.objects)
        figures = [
            _measure(scene, root, options.objects, opening) for opening in ("first", "again")
        ]
    return Result(figures, lambda: print_figures("A scene appears, on the server", figures))


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
        entries.append(
            {
                "id": name,
                "description": "cabinet" if cabinet else "block",
                "asset": name,
                "position": [1.2 * (k % side), 1.2 * (k // side), 0.0],
                "quaternion_wxyz": [1, 0, 0, 0],
                "scale": [size] * 3,
                "anchor": "base",
            }
        )
    path = root / "scene.json"
    path.write_text(json.dumps({"artiworld_scene": 1, "name": "bench", "objects": entries}))
    return path


_CABINET = (
    ((0.0, 0.0, 0.0), (0.6, 0.5, 0.8)),
    ((0.0, -0.02, 0.02), (0.29, 0.0, 0.78)),
    ((0.31, -0.02, 0.02), (0.6, 0.0, 0.78)),
)


def _measure(scene: Path, root: Path, objects: int, opening: str) -> dict[str, Any]:
    """Figures of one opening, "again" with cached pictures; milliseconds from the server's start.

    ``first`` is until any part of the scene was received, ``whole`` until every object was sent;
    ``loop_held_ms`` the longest time that one callback blocked the event loop; ``pick_ms``
    processor time to find the object under a click; memory in MiB, of the server and its workers.
    """
    start, used = time.perf_counter(), processor_seconds(os.getpid())
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
        picture, least = app.scene.picture, min(PICTURE_BYTES, 10 * FACES * objects)
        wait_for(lambda: picture.nodes and browser.received > least, "the first object")
        figures: dict[str, Any] = {"opening": opening, "objects": objects}
        figures["first_ms"] = 1000 * (time.perf_counter() - start)
        worker = server.app_state.workers.geometry.pid
        of_worker = 0.0 if worker is None else processor_seconds(worker)
        figures["first_cpu_ms"] = 1000 * (processor_seconds(os.getpid()) - used + of_worker)
        wait_for(
            lambda: len({i for node in picture.nodes for i in node.ids}) == objects,
            "the whole scene",
        )
        figures["sent_mb"] = browser.quiet() / 1e6
        figures["whole_ms"] = 1000 * (browser.last - start)
        figures["memory_mb"] = _memory(os.getpid())
        figures["loop_held_ms"] = 1000 * watch.worst
        watch.stop()
        figures["pick_ms"] = _pick(app)
        browser.close()
        return figures
    finally:
        server.close()


def _pick(app: Any) -> float:
    picture, rng, taken = app.scene.picture, np.random.default_rng(1), []
    low, high = picture.bounds()
    for _ in range(20):
        target = rng.uniform(low, high)
        origin = target + np.array([3.0, -8.0, 6.0])
        start = time.thread_time()  # the machine may be busy
        picture.pick(origin, (target - origin) / np.linalg.norm(target - origin))
        taken.append(time.thread_time() - start)
    return 1000 * float(np.median(taken))


POINTS = 20_000
"""Points of each scan."""
FRONT = np.array([-0.4, -0.272, 0.0])
"""A corner of the drawers' fronts, metres."""


def team_bench(options: TeamBench, progress: Progress) -> Result:
    """Measure with the options of the command."""
    with tempfile.TemporaryDirectory(prefix="artiworld-team-") as folder:
        row = _measure_team(Path(folder), options, progress)
    failed = bool(row["errors"])
    report = {"rows": [row], "failed": failed}
    return Result(report, lambda: print_records(f"{options.people} people", [row]), int(failed))


def _measure_team(root: Path, options: TeamBench, progress: Progress) -> dict[str, Any]:
    people, seed, database = options.people, options.seed, options.database
    rng = np.random.default_rng(seed)
    scans = [root / f"scan {k}.ply" for k in range(people)]
    for path in scans:
        write_cloud(cabinet_cloud(POINTS, rng), path)
    tokens = _tokens(root / "workspace", database, people)
    port = free_port("127.0.0.1")
    url = f"http://127.0.0.1:{port}"
    words = [sys.executable, "-m", "app.cli.main", "serve", *map(str, scans), "--port", f"{port}"]
    if database is not None:
        words += ["--database", database]
    with (
        (root / "log").open("wb") as log,
        subprocess.Popen(
            [*words, "--workspace", str(root / "workspace")], stdout=log, stderr=log
        ) as server,
    ):
        try:
            wait_for(lambda: server.poll() is not None or _answers(url), "the server")
            idle = _memory(server.pid)
            clients = [Client(url, token) for token in tokens]
            ids = [o["id"] for o in clients[0].objects()]
            jobs = list(zip(clients, ids, range(people), strict=True))
            progress(0.05, "first clicks: every scan is read and encoded")
            first = _together([_Person(*job, seed, 0.0) for job in jobs])
            ready = _memory(server.pid)
            progress(0.2, "clicks")
            found = _together([_Person(*job, seed, float(options.seconds)) for job in jobs])
            after = _memory(server.pid)
        finally:
            server.terminate()
    return _row(people, first, found, (idle, ready, after))


def _row(
    people: int, first: list[_Person], found: list[_Person], memory: tuple[float, float, float]
) -> dict[str, Any]:
    errors = sum((p.errors for p in [*first, *found]), Counter())
    taken = [t for p in found for t in p.taken]
    began = [p.taken[0] for p in first if p.taken]
    return {
        "people": people,
        "clicks": len(taken),
        "errors": sum(errors.values()),
        **waiting_times(taken),
        "first click p95 s": round(float(np.percentile(began, 95)), 1) if began else None,
        "idle MB": round(memory[0]),
        "all open MB": round(memory[1]),
        "after MB": round(memory[2]),
        **{f"status {status}": count for status, count in sorted(errors.items())},
    }


class _Person(threading.Thread):
    """One person; ``seconds`` of 0 is a single click, however long it takes."""

    def __init__(
        self, client: Client, object_id: int, number: int, seed: int, seconds: float
    ) -> None:
        super().__init__(daemon=True)
        self._client, self._id, self._seconds = client, object_id, seconds
        self._rng = np.random.default_rng((seed, number, int(seconds)))
        self.taken: list[float] = []
        self.errors: Counter[int] = Counter()

    def run(self) -> None:
        """Click until the time is over."""
        end, prompts = time.perf_counter() + self._seconds, 0
        while True:
            try:
                self.taken.append(self._click())
                prompts += 1
                if prompts >= MOST_PROMPTS:
                    self._client.command(self._id, kind="clear_prompts")
                    prompts = 0
            except ApiError as error:
                self.errors[error.status] += 1
            if time.perf_counter() > end:
                return
            time.sleep(self._rng.uniform(*PAUSE))

    def _click(self) -> float:
        """Seconds from a click until its labels are there."""
        drawer = int(self._rng.integers(3))
        origin, direction = drawer_ray(FRONT, drawer, self._rng)
        away = (FRONT[1] - origin[1]) / direction[1]
        place = [o + away * d for o, d in zip(origin, direction, strict=True)]
        click = {"position": place, "part": 1 + drawer, "positive": True, "element": None}
        start = time.perf_counter()
        self._client.command(self._id, labels=True, kind="add_click", click=click)
        return time.perf_counter() - start


def _together(people: list[_Person]) -> list[_Person]:
    for person in people:
        person.start()
    for person in people:
        person.join()
    return people


def _tokens(workspace: Path, database: str | None, people: int) -> list[str]:
    store = Store(workspace, database)
    try:
        out = []
        for k in range(people):
            account = store.people.accounts.add(f"person {k}", "annotator", f"a long password {k}")
            scopes = ("read", "annotate")
            out.append(store.people.credentials.make_token(account, "bench", scopes))
        return out
    finally:
        store.close()


def _answers(url: str) -> bool:
    try:
        return urllib.request.urlopen(f"{url}/healthz", timeout=1).status == 200
    except OSError:
        time.sleep(0.2)
        return False


def _memory(pid: int) -> float:
    """Megabytes of a process with all that it started, shared pages counted once."""
    total, at = 0.0, Path(f"/proc/{pid}")
    with suppress(OSError):  # it has just ended
        lines = (at / "smaps_rollup").read_text().splitlines()
        total = sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024
        started = (each for file in at.glob("task/*/children") for each in file.read_text().split())
        total += sum(_memory(int(each)) for each in started)
    return total
