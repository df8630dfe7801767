"""Six people click at one server, first alone, then while a seventh opens the worst files.

Each works in a tab of its own on a scan of its own, as :mod:`app.cli.benchmarks.ui` simulates it. A
click lasts until the browser has its labels; one without them after half a minute is lost. The
seventh clicks on what opens.
"""

from __future__ import annotations

import itertools
import json
import os
import tempfile
import threading
import time
from base64 import b64encode
from collections import Counter
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from app.cli.benchmarks.ui import SimulatedBrowser, cabinet_cloud, drawer_ray, wait_for
from app.cli.serve import start_server
from app.server.config import ServeConfig
from model.core.progress import Progress
from model.io.write import write_cloud

PEOPLE, POINTS = 6, 50_000
"""Six scans of so many points stay encoded together."""
QUIET = 0.25
"""Time without worst files, as a share of the time with them."""
PAUSE = 0.5, 2.0
"""Seconds between two clicks of a person."""
MOST_PROMPTS = 6
"""On an object; then they are taken back."""
LOST, LOOK = 30.0, 20.0
"""Seconds after which a click is lost, and after which a person leaves what doesn't open."""
_CORNERS = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]], "<f4")
TRIANGLE = f"data:application/octet-stream;base64,{b64encode(_CORNERS.tobytes()).decode()}"


def click_beside(seconds: int, seed: int, progress: Progress) -> list[dict[str, Any]]:
    """Measure clicks without and with somebody who opens the worst files.

    Returns:
        One row each: clicks, those lost, times in ms of the others, their 95th percentile by the
        one without, and the number of worst files that opened, were refused, or were left.
    """
    with tempfile.TemporaryDirectory(prefix="artiworld-clients-") as folder:
        root = Path(folder)
        rng = np.random.default_rng(seed)
        scans = tuple(root / f"scan {i}.ply" for i in range(PEOPLE))
        for path in scans:
            write_cloud(cabinet_cloud(POINTS, rng), path)
        worst = write_worst(root)
        server: Any = start_server(ServeConfig(paths=scans, workspace=root / "workspace", port=0))
        try:
            ids = [record.id for record in server.app_state.queue.records()]
            tabs = [_tab(server, id) for id in (*ids, ids[0])]
            progress(0.1, "alone")
            rows = [_phase(tabs[:-1], seconds * QUIET, seed, None)]
            attack = partial(_open, server, tabs[-1][1], worst)
            progress(QUIET, "beside the worst files")
            rows.append(_phase(tabs[:-1], seconds, seed + 1, attack))
        finally:
            server.close()
    return [{**row, "p95 ratio": round(row["p95 ms"] / rows[0]["p95 ms"], 2)} for row in rows]


def _tab(server: Any, id: int) -> tuple[SimulatedBrowser, Any]:
    """A browser and what the server shows it: an object that is ready for clicks."""
    known = set(server.apps)
    browser = SimulatedBrowser(server.url)
    wait_for(lambda: set(server.apps) - known, "the tab")
    app = server.apps[next(iter(set(server.apps) - known))]
    shown = app.tab.selection
    wait_for(lambda: shown.object is not None, "its first object")
    app.tab.act(lambda: app._navigation.open(id))
    wait_for(lambda: shown.object.record.id == id and shown.object.asset is not None, "its own")
    timed_click(browser, app, np.random.default_rng(id))  # is answered once it is encoded
    app.tab.act(app.commands.undo)
    # A click before that would seem lost, as prompts become fewer.
    wait_for(lambda: not shown.object.document.prompts, "the undone click")
    wait_for(lambda: not shown.object.busy, "the segmenter")
    return browser, app


def _phase(tabs: list[tuple[Any, Any]], seconds: float, seed: int, attack: Any) -> dict[str, Any]:
    """Let everybody click for so long, beside ``attack``, which gets the end; one row."""
    end, taken = time.perf_counter() + seconds, list[float]()
    threads = [
        threading.Thread(target=_work, args=(*tab, end, np.random.default_rng((seed, i)), taken))
        for i, tab in enumerate(tabs)
    ]
    for thread in threads:
        thread.start()
    files = Counter[str]() if attack is None else attack(end)
    for thread in threads:
        thread.join()
    times = [1000 * t for t in taken if t < LOST] or [1000 * LOST]
    p50, p95, most = (round(float(v)) for v in np.percentile(times, (50, 95, 100)))
    lost = sum(t >= LOST for t in taken)
    return {
        "with": "the worst files" if attack else "nobody else", "clicks": len(taken), "lost": lost,
        "p50 ms": p50, "p95 ms": p95, "longest ms": most,
        **{what: files[what] for what in ("opened", "refused", "left")},
    }  # fmt: skip


def _work(
    browser: SimulatedBrowser, app: Any, end: float, rng: np.random.Generator, taken: list[float]
) -> None:
    obj = app.tab.selection.object
    while time.perf_counter() < end:
        taken.append(timed_click(browser, app, rng))
        if len(obj.document.prompts) >= MOST_PROMPTS:
            for _ in obj.document.prompts:
                app.tab.act(app.commands.undo)
            wait_for(lambda: not obj.document.prompts, "the undone clicks")
        time.sleep(rng.uniform(*PAUSE))


def timed_click(browser: SimulatedBrowser, app: Any, rng: np.random.Generator) -> float:
    """Seconds from a click until the browser has its labels, or :data:`LOST`."""
    obj, drawer = app.tab.selection.object, int(rng.integers(3))
    app.tab.selection.part = 1 + drawer
    ray, count = drawer_ray(obj.asset.bounds[0], drawer, rng), len(obj.document.prompts)
    start = time.perf_counter()
    app.tab.act(lambda: app.pointing.click(*ray, True))
    while not (
        len(obj.document.prompts) > count
        and obj.document.segmentation_current
        and app.drawing.shows_labels
    ):
        if time.perf_counter() - start > LOST:
            return LOST
        time.sleep(0.002)
    sent = time.perf_counter()
    while browser.last < sent and time.perf_counter() < sent + 0.1:
        time.sleep(0.002)
    return max(browser.last, sent) - start


def _open(server: Any, app: Any, worst: list[Path], end: float) -> Counter[str]:
    """Open the worst files one after the other, each time as new; what became of them."""
    files: Counter[str] = Counter()
    for number in itertools.count():
        if time.perf_counter() > end:
            break
        path = worst[number % len(worst)]
        again = path.with_name(f"{number}-{path.name}")
        os.link(path, again)
        record = server.app_state.store.open_object(again, None, again.stem)
        app.tab.act(lambda id=record.id: app._navigation.open(id))
        obj, began = server.app_state.object(record.id), time.perf_counter()
        while obj.asset is None and not obj.problem and time.perf_counter() < began + LOOK:
            time.sleep(0.05)
        if obj.asset is not None:
            _look_at(app, obj, began + LOOK)
        files["opened" if obj.asset is not None else "refused" if obj.problem else "left"] += 1
    return files


def _look_at(app: Any, obj: Any, until: float) -> None:
    """Click on an object from three sides, and look at it until that is answered."""
    middle, size = obj.asset.bounds.mean(0), obj.asset.diagonal
    for part, away in enumerate(np.array([[0.1, 0.1, 1], [0.1, -1, 0.1], [1, 0.1, 0.1]]), 1):
        app.tab.selection.part = part
        ray = tuple(middle + size * away), tuple(-away)
        app.tab.act(lambda ray=ray: app.pointing.click(*ray, True))
    time.sleep(1.0)  # until the clicks have begun
    while (obj.busy or not obj.document.segmentation_current) and time.perf_counter() < until:
        time.sleep(0.05)


def write_worst(folder: Path) -> list[Path]:
    """Write files that cost much: their reading was quadratic, exponential, or took gigabytes."""
    out = [
        folder / f"{n}" for n in ("face.obj", "shared.gltf", "nodes.gltf", "line.csv", "map.obj")
    ]
    turn = np.linspace(0, 2 * np.pi, 100_000, endpoint=False)
    radius = np.where(np.arange(len(turn)) % 2, 1.0, 0.5)
    star = np.column_stack((radius * np.cos(turn), radius * np.sin(turn), 0 * turn))
    corners = " ".join(map(str, range(1, len(turn) + 1)))
    out[0].write_text("".join(f"v {x} {y} {z}\n" for x, y, z in star) + f"f {corners}\n")
    chain = [{"children": [i + 1, i + 1]} for i in range(40)] + [{"mesh": 0}]
    for path, nodes in ((out[1], chain), (out[2], [{"mesh": 0}] * 200_000)):
        scene = {"nodes": [0] if nodes is chain else list(range(len(nodes)))}
        path.write_text(json.dumps({
            "asset": {"version": "2.0"}, "scene": 0, "scenes": [scene], "nodes": nodes,
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
            "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3",
                           "min": [0, 0, 0], "max": [1, 1, 0]}],
            "bufferViews": [{"buffer": 0, "byteLength": 36}],
            "buffers": [{"byteLength": 36, "uri": TRIANGLE}],
        }))  # fmt: skip
    out[3].write_text("1.5,2.5,3.5," * 10_000_000)
    out[4].write_text(
        "mtllib map.mtl\nusemtl a\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1\n"
    )
    (folder / "map.mtl").write_text("newmtl a\nmap_Kd map.png\n")
    Image.new("L", (13_000, 13_000)).save(folder / "map.png")
    return out
