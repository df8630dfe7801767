"""``artiworld bench ui``: a person's waiting times, measured on the server.

The browser is simulated by a websocket client that speaks viser's protocol, receives every byte
and draws nothing. The baseline of the same run is the cost of sending the whole object again, as
a viewer without differences does.
"""

from __future__ import annotations

import asyncio
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec.msgpack
import numpy as np
import viser
import zstandard
from websockets.exceptions import ConnectionClosed
from websockets.sync.client import connect

from app.cli.bench_commands import UiBench
from app.cli.benchmarks.shapes import Array, grid_box
from app.cli.output import Result, print_figures
from app.cli.serve import start_server
from app.server.config import ServeConfig
from model.core.geometry import Mesh, PointCloud, merged
from model.core.progress import Progress
from model.io.write import write_cloud, write_mesh

WAIT_SECONDS = 300.0
HEARTBEAT = 0.002
"""Seconds between two callbacks of :class:`LoopWatch`."""
PAUSE = 0.5, 2.0
"""Seconds between two clicks of a person."""
MOST_PROMPTS = 6
"""Prompts on an object before they are taken back."""


class SimulatedBrowser:
    """A client that receives everything and draws nothing."""

    def __init__(self, url: str) -> None:
        self.received = 0
        self.last = 0.0
        self._socket = connect(
            url.replace("http", "ws", 1),
            subprotocols=[f"viser-v{viser.__version__}"],  # type: ignore[list-item]
            max_size=None,
            compression=None,
        )
        camera = {
            "type": "ViewerCameraMessage",
            "wxyz": (1.0, 0.0, 0.0, 0.0),
            "position": (0.0, -3.0, 1.0),
            "fov": 0.7,
            "near": 0.01,
            "far": 100.0,
            "image_height": 800,
            "image_width": 1200,
            "look_at": (0.0, 0.0, 0.0),
            "up_direction": (0.0, 0.0, 1.0),
        }
        self._socket.send(msgspec.msgpack.encode(camera))
        self._asked = False
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def _read(self) -> None:
        try:
            for message in self._socket:
                self.received += len(message)
                self.last = time.perf_counter()
                if not self._asked and isinstance(message, bytes):
                    self._answer(message)
        except ConnectionClosed:
            return

    def _answer(self, message: bytes) -> None:
        """Say that nothing is stored, once the server asks; it waits for that before it draws."""
        size = int.from_bytes(message[8:16], "little")
        inner = msgspec.msgpack.decode(zstandard.decompress(message[16 : 16 + size]))
        for each in inner["messages"]:
            if each["type"] == "LocalStorageGetItemRequestMessage":
                self._asked = True
                answer = {
                    "type": "LocalStorageGetItemResponseMessage",
                    "value": None,
                    "error": None,
                    "request_uuid": each["request_uuid"],
                }
                self._socket.send(msgspec.msgpack.encode(answer))

    def quiet(self, seconds: float = 0.25) -> int:
        """Wait until nothing has come for ``seconds``; return the bytes received so far."""
        while time.perf_counter() - self.last < seconds:
            time.sleep(0.01)
        return self.received

    def close(self) -> None:
        """End the connection."""
        self._socket.close()


class LoopWatch:
    """Measures the longest time in seconds that one callback blocks the server's event loop."""

    def __init__(self, loop: asyncio.AbstractEventLoop) -> None:
        self.worst = 0.0
        self._loop = loop
        self._on = True
        loop.call_soon_threadsafe(self._beat, None)

    def _beat(self, due: float | None) -> None:
        now = self._loop.time()
        if due is not None:
            self.worst = max(self.worst, now - due)
        if self._on:
            self._loop.call_later(HEARTBEAT, self._beat, now + HEARTBEAT)

    def stop(self) -> None:
        """No more beats."""
        self._on = False


def ui_bench(options: UiBench, _: Progress) -> Result:
    """Measure with the options of the command."""
    with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
        root = Path(folder)
        figures = [
            _measure(path, root / f"workspace-{path.stem}", options)
            for path in _objects(options, root)
        ]
    title = "The browser's waiting times, on the server"
    return Result(figures, lambda: print_figures(title, figures))


def _objects(options: UiBench, root: Path) -> list[Path]:
    rng = np.random.default_rng(0)
    out = []
    for count in options.points:
        path = root / f"cloud_{count}.ply"
        write_cloud(cabinet_cloud(count, rng), path)
        out.append(path)
    if options.faces:
        path = root / f"mesh_{options.faces}.ply"
        write_mesh(_cabinet_mesh(options.faces), path)
        out.append(path)
    return out


def _panels() -> list[tuple[Array, Array]]:
    """Boxes of a cabinet with three drawers: (centre, size)."""
    boxes = [((0.0, 0.0, 0.45), (0.8, 0.5, 0.9))]
    boxes += [((0.0, -0.262, 0.15 + 0.3 * k), (0.78, 0.02, 0.28)) for k in range(3)]
    return [(np.array(c), np.array(s)) for c, s in boxes]


def cabinet_cloud(count: int, rng: np.random.Generator) -> PointCloud:
    """Make a noisy scan of a cabinet with three drawers."""
    points, shares = [], np.array([0.55, 0.15, 0.15, 0.15])
    for (center, size), share in zip(_panels(), shares, strict=True):
        n = int(count * share)
        p = rng.uniform(-0.5, 0.5, (n, 3))
        side = rng.integers(0, 3, n)
        p[np.arange(n), side] = np.where(rng.random(n) < 0.5, -0.5, 0.5)
        points.append(center + p * size)
    cloud = np.concatenate(points) + rng.normal(0, 0.0007, (sum(map(len, points)), 3))
    shade = (150 + 40 * np.sin(9 * cloud[:, [0]]) + rng.normal(0, 6, (len(cloud), 3))).clip(0, 255)
    return PointCloud(cloud.astype(np.float32), None, shade.astype(np.uint8))


def _cabinet_mesh(faces: int) -> Mesh:
    cells = max(2, int(np.sqrt(faces / (len(_panels()) * 6 * 2))))
    return merged([grid_box(cells, center, size) for center, size in _panels()])


def wait_for(condition: Callable[[], Any], what: str) -> Any:
    """Poll until ``condition()`` is true; return its value.

    Raises:
        TimeoutError: naming ``what`` did not happen.
    """
    end = time.perf_counter() + WAIT_SECONDS
    while not (value := condition()):
        if time.perf_counter() > end:
            raise TimeoutError(f"waited {WAIT_SECONDS:.0f} s for: {what}")
        time.sleep(0.0005)
    return value


def _measure(path: Path, workspace: Path, options: UiBench) -> dict[str, Any]:
    """Figures of one object; bytes "a click" are the 95th percentile, "whole" ones the baseline's.

    ``loop_held_ms`` is the longest time that one callback blocked the event loop.
    """
    config = ServeConfig(
        paths=(path,), workspace=workspace, port=0, user="bench", segmenter=options.segmenter
    )
    server = start_server(config)
    try:
        start = time.perf_counter()
        server.app_state.object(server.app_state.queue.records()[0].id)
        browser = SimulatedBrowser(server.url)
        wait_for(lambda: server.apps, "the tab")
        app: Any = next(iter(server.apps.values()))
        shown = app.tab.selection
        wait_for(lambda: shown.object is not None and shown.object.asset is not None, "the object")
        wait_for(lambda: app.drawing.drawn, "the picture")
        drawn = time.perf_counter()
        figures = {
            "name": path.stem,
            "elements": shown.object.asset.element_count,
            "open_ms": 1000 * (drawn - start),
        }
        wait_for(lambda: not shown.object.busy, "the segmenter")
        figures["encode_ms"] = 1000 * (time.perf_counter() - drawn)
        browser.quiet()
        watch = LoopWatch(server.viser.get_event_loop())
        figures |= _click(app, browser, options.clicks)
        figures["loop_held_ms"] = 1000 * watch.worst
        watch.stop()
        figures |= _baseline(app, browser)
        browser.close()
        return figures
    finally:
        server.close()


def waiting_times(seconds: list[float]) -> dict[str, Any]:
    """Median, 95th percentile and longest of some times, in ms; None without any."""
    names = ("p50 ms", "p95 ms", "longest ms")
    if not seconds:
        return dict.fromkeys(names)
    found = 1000 * np.percentile(seconds, (50, 95, 100))
    return {name: round(float(value), 1) for name, value in zip(names, found, strict=True)}


def drawer_ray(low: Array, drawer: int, rng: np.random.Generator) -> tuple[Any, Any]:
    """A ray that meets a drawer of the cabinet from the front: origin and direction."""
    target = np.array([rng.uniform(-0.3, 0.3), low[1], 0.15 + 0.3 * drawer])
    target[2] += rng.uniform(-0.1, 0.1)
    origin = np.array([target[0] + 0.3, low[1] - 2.0, target[2] + 0.3])
    direction = (target - origin) / np.linalg.norm(target - origin)
    return tuple(map(float, origin)), tuple(map(float, direction))


def _click(app: Any, browser: SimulatedBrowser, clicks: int) -> dict[str, Any]:
    """Click on random visible points of three drawers, each for its own part."""
    rng = np.random.default_rng(1)
    shown = app.tab.selection
    asset, taken, sent = shown.object.asset, [], []
    low = asset.bounds[0]
    for k in range(clicks):
        shown.part = 1 + k % 3
        ray = drawer_ray(low, k % 3, rng)
        before, count = browser.quiet(0.3), len(shown.object.document.prompts)
        start = time.perf_counter()
        app.tab.act(lambda ray=ray: app.pointing.click(*ray, True))
        wait_for(
            lambda count=count: len(app.tab.selection.object.document.prompts) > count, "the prompt"
        )
        wait_for(
            lambda: (
                app.tab.selection.object.document.segmentation_current and app.drawing.shows_labels
            ),
            "the labels",
        )
        taken.append(time.perf_counter() - start)
        sent.append(browser.quiet(0.3) - before)
    p50, p95 = (1000 * float(v) for v in np.percentile(taken, (50, 95)))
    sizes = {"bytes_a_click": int(np.percentile(sent, 95))}
    return {"click_p50_ms": p50, "click_p95_ms": p95, **sizes}


def _baseline(app: Any, browser: SimulatedBrowser) -> dict[str, Any]:
    """Send the whole object again, as a viewer without differences does at each click."""
    asset = app.tab.selection.object.asset
    before, start = browser.quiet(), time.perf_counter()
    app.picture.show_asset(asset)
    wait_for(lambda: browser.last > start, "the whole object")
    size = browser.quiet(1.0) - before
    return {"whole_bytes": size, "whole_ms": 1000 * (browser.last - start)}
