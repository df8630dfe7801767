"""``artiworld bench team``: many people work through the REST API at one server.

Each has an account, a token and a scan of their own, and clicks on it as annotators do. A click
lasts until the answer, which waits for its labels; one without them after a minute is an error.
The server is a process of its own. Memory is the proportional set size of the server with all its
workers, as Linux counts it.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
import urllib.request
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from app.cli.benchmarks.ui import cabinet_cloud, drawer_ray, wait_for
from app.cli.output import Result, print_records
from app.cli.research_commands import BenchCommand
from app.client import ApiError, Client
from app.server.network import free_port
from model.core.progress import Progress
from model.io.write import write_cloud
from sessions.store import Store

POINTS = 20_000
"""Points of each scan."""
FRONT = np.array([-0.4, -0.272, 0.0])
"""A corner of the drawers' fronts, metres."""
PAUSE = 0.5, 2.0
"""Seconds between two clicks of a person."""
MOST_PROMPTS = 6
"""Prompts on an object before they are cleared."""


def bench(options: BenchCommand, progress: Progress) -> Result:
    """Measure with the options of the command."""
    with tempfile.TemporaryDirectory(prefix="artiworld-team-") as folder:
        row = _measure(Path(folder), options, progress)
    report = {"rows": [row], "failed": bool(row["errors"])}
    return report, lambda: print_records(f"{options.people} people", report["rows"])


def _measure(root: Path, options: BenchCommand, progress: Progress) -> dict[str, Any]:
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
    with (root / "log").open("wb") as log, subprocess.Popen(
        [*words, "--workspace", str(root / "workspace")], stdout=log, stderr=log
    ) as server:  # fmt: skip
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
    p50, p95, most = (_percentile(taken, q, 1000) for q in (50, 95, 100))
    return {
        "people": people, "clicks": len(taken), "errors": sum(errors.values()),
        "p50 ms": p50, "p95 ms": p95, "longest ms": most,
        "first click p95 s": _percentile(began, 95),
        "idle MB": round(memory[0]), "all open MB": round(memory[1]), "after MB": round(memory[2]),
        **{f"status {status}": count for status, count in sorted(errors.items())},
    }  # fmt: skip


def _percentile(seconds: list[float], q: float, scale: float = 1.0) -> float | None:
    """Percentile ``q`` of times, multiplied by ``scale``; None without any."""
    return round(float(np.percentile(seconds, q)) * scale, 1) if seconds else None


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
    parents: dict[int, int] = {}
    for entry in filter(str.isdigit, os.listdir("/proc")):
        try:
            fields = Path(f"/proc/{entry}/stat").read_text().rpartition(")")[2].split()
            parents[int(entry)] = int(fields[1])
        except OSError:
            continue  # it has just ended
    mine, total = {pid}, 0.0
    while more := {p for p, parent in parents.items() if parent in mine} - mine:
        mine |= more
    for each in mine:
        try:
            lines = Path(f"/proc/{each}/smaps_rollup").read_text().splitlines()
        except OSError:
            continue
        total += sum(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024
    return total
