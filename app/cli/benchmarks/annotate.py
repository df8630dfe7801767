"""``artiworld bench annotate``: waiting times on the way from raw scans to accepted assets.

Ground-truth objects are scanned as phones do (:mod:`model.data.simulated.depth_camera`), at any
rotation and scale on a table, and lie in one queue. A script works through it at the server as a
tab does: it levels each scan, clicks its moving parts, names them, predicts, accepts and goes on.
A person's own time is that of the keystroke-level model (Card, Moran and Newell, 1980) and passes
in real time before each action, while the server goes on; what remains of the clock is waiting.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from app.cli.benchmarks.ui import SimulatedBrowser, wait_for
from app.cli.serve import start_server
from app.server.config import ServeConfig

if TYPE_CHECKING:
    from app.cli.bench_commands import AnnotateBench
    from app.cli.output import Result
    from model.core.progress import Progress

KEY, POINT, MENTAL = 0.28, 1.1, 1.35
"""Seconds of the keystroke-level model."""
STEPS = ("open", "prepare", "clicks", "joints", "accept")
SUMMED = ("parts", *STEPS, "waiting", "person")


def annotate_bench(options: AnnotateBench, progress: Progress) -> Result:
    """Measure with the options of the command, here and with an earlier checkout."""
    from app.cli.output import Result, print_records

    here = Path(__file__).resolve().parents[3]
    places = {"today": here} | ({} if options.before is None else {"before": options.before})
    with tempfile.TemporaryDirectory(prefix="artiworld-bench-") as folder:
        root = Path(folder)
        _write_scans(options, root / "scans", progress)
        rows = []
        for name, place in places.items():
            rows += [{"code": name, **row} for row in _run(place, root, name)]
    rows.sort(key=lambda row: row["object"])
    for name in places:
        mine = [row for row in rows if row["code"] == name]
        sums = {k: round(sum(row[k] for row in mine), 2) for k in SUMMED}
        rows.append({"code": name, "object": "all", **sums})
    return Result(rows, lambda: print_records("Seconds that a person waits", rows))


def _run(place: Path, root: Path, name: str) -> list[dict[str, Any]]:
    """Work through the scans in a process of its own, with the code at ``place``."""
    out = root / f"{name}.json"
    environment = {**os.environ, "PYTHONPATH": str(place)}
    command = [sys.executable, "-P", __file__, str(root / "scans"), str(root / name), str(out)]
    subprocess.run(command, env=environment, cwd=place, check=True, stdout=sys.stderr)
    return json.loads(out.read_text())


def _write_scans(options: AnnotateBench, folder: Path, progress: Progress) -> None:
    """Write the scans, and beside each where its parts are clicked."""
    from model.data.registry import DatasetOptions, open_dataset
    from model.data.simulated.depth_camera import ReconstructionSettings, reconstruct_scan
    from model.evaluation.bench import half_of
    from model.io.write import write_cloud
    from model.segmentation.prompts import deepest

    folder.mkdir()
    root = options.data
    data = open_dataset(DatasetOptions("bundled" if root is None else "partnet-mobility", root))
    ids = half_of(data.ids(), "all" if root is None else options.half, 0, options.limit or 0)
    for number, object_id in enumerate(ids):
        progress(number / len(ids), object_id)
        truth = data.load(object_id).object
        settings = ReconstructionSettings(points=options.points)
        scan = reconstruct_scan(truth, settings, np.random.default_rng(number))
        points = scan.cloud.points.astype(np.float64)
        middle = points[scan.part >= 0].mean(0)
        moving = {joint.child for joint in truth.tree.joints if joint.moves}
        clicks = []
        for index, part in enumerate(truth.parts):
            mine = scan.part == index
            if part.link in moving and mine.sum() > 50:
                place = points[deepest(points, mine)]
                clicks.append({"name": part.name, "place": place.tolist()})
        write_cloud(scan.cloud, folder / f"{number:02d}_{object_id}.ply")
        about = {"clicks": clicks, "middle": middle.tolist()}
        (folder / f"{number:02d}_{object_id}.json").write_text(json.dumps(about))


class _Person:
    """Works at one tab, and counts seconds."""

    def __init__(self, app: Any) -> None:
        self.app, self.own = app, 0.0
        self.waited: dict[str, float] = dict.fromkeys(STEPS, 0.0)
        self._since = time.perf_counter()

    def act(self, seconds: float, action: Callable[[], object]) -> None:
        """Let the time of a person pass, then do something in the tab."""
        time.sleep(seconds)
        self.own += seconds
        self._since += seconds
        self.app.tab.act(action)

    def wait(self, step: str, condition: Callable[[], Any]) -> Any:
        """Wait for the server; it counts for ``step``."""
        found = wait_for(condition, step)
        now = time.perf_counter()
        self.waited[step] += now - self._since
        self._since = now
        return found

    def work(self, about: dict[str, Any], *, last: bool) -> None:
        """Take the open object from its file to the acceptance, and on to the next one."""
        app, shown = self.app, self.app.tab.selection
        obj = self.wait("open", lambda: shown.object)
        self.wait("open", lambda: obj.asset and app.drawing.drawn and obj.preparing.current)
        self.act(MENTAL, lambda: shown.set_step("Prepare"))
        self.wait("prepare", lambda: shown.step == "Prepare" and obj.preparing.current)
        raw = obj.asset
        self.act(KEY + MENTAL, app.prepare.apply)
        self.wait("prepare", lambda: shown.step == "Annotate")
        if obj.document.frame.wxyz != (1.0, 0.0, 0.0, 0.0) or obj.document.left_out is not None:
            self.wait("prepare", lambda: obj.asset not in (None, raw))
        self.wait("prepare", lambda: obj.asset and app.drawing.drawn)
        frame = np.asarray(obj.document.frame.object_from_read, np.float64)
        for part, click in enumerate(about["clicks"], 1):
            self._click(part, click, about, frame)
        self.act(KEY + MENTAL, lambda: obj.predict(app.tab.user))
        self.wait("joints", lambda: obj.document.tree is not None)
        self.act(2 * MENTAL, lambda: None)
        self._accept(obj, last=last)

    def _click(self, part: int, click: dict[str, Any], about: dict[str, Any], frame: Any) -> None:
        from sessions.commands import NamePart

        app, shown = self.app, self.app.tab.selection
        place, middle = (
            frame[:3, :3] @ click_place + frame[:3, 3]
            for click_place in (np.array(click["place"]), np.array(about["middle"]))
        )
        drawn = shown.object.asset.display_centers
        place = drawn[np.linalg.norm(drawn - place, axis=1).argmin()]  # it may be left out
        away = place - middle
        away /= np.linalg.norm(away)
        origin = tuple(map(float, place + shown.object.asset.diagonal * away))
        before = len(shown.object.document.prompts)

        def press() -> None:
            shown.choose_part(part)
            app.pointing.click(origin, tuple(map(float, -away)), True)

        self.act(KEY + POINT + MENTAL, press)
        self.wait("clicks", lambda: len(shown.object.document.prompts) > before)
        self.wait(
            "clicks",
            lambda: shown.object.document.segmentation_current and app.drawing.shows_labels,
        )
        if click["name"]:
            self.act(KEY + MENTAL, lambda: app.tab.do(NamePart(part, click["name"])))

    def _accept(self, obj: Any, *, last: bool) -> None:
        """Accept it whatever the checks will find, and go on to the next object if there is one."""
        from app.server.accepting import Order, accept

        app, shown = self.app, self.app.tab.selection
        order = Order(looked=True)
        self.act(KEY, lambda: accept(obj, "", app.tab.user, "looks right", order=order))
        self.act(0.0, app.commands.go_on)
        self.wait("accept", lambda: shown.object is not obj or last)


def main(scans: Path, workspace: Path, out: Path) -> None:
    """Work through a folder of scans with a server, and write seconds by object."""
    files = sorted(scans.glob("*.ply"))
    config = ServeConfig(paths=tuple(files), workspace=workspace, port=0, user="bench")
    server = start_server(config)
    rows = []
    try:
        browser = SimulatedBrowser(server.url)
        wait_for(lambda: server.apps, "the tab")
        app: Any = next(iter(server.apps.values()))
        queue = server.app_state.queue
        while len(rows) < len(files):
            name = wait_for(lambda: app.tab.selection.object, "an object").record.name
            if any(row["object"] == name for row in rows):
                app.tab.act(lambda: app.commands.step(1))
                time.sleep(1.0)
                continue
            about = json.loads((scans / f"{name}.json").read_text())
            person = _Person(app)
            person.work(about, last=len(rows) + 1 == len(files))
            waited = {step: round(seconds, 2) for step, seconds in person.waited.items()}
            row = {"object": name, "parts": len(about["clicks"]), **waited}
            whole, own = round(sum(waited.values()), 2), round(person.own, 2)
            rows.append({**row, "waiting": whole, "person": own})
            print(json.dumps(rows[-1]), flush=True)
        held, end = server.app_state.on_hold, time.monotonic() + 120.0
        while not all(held(r) or r.state == "accepted" for r in queue.records()):
            if time.monotonic() > end:  # one was refused
                break
            time.sleep(0.1)
        states = {r.name: held(r) or r.state for r in queue.records()}
        rows = [{**row, "state": states[row["object"]]} for row in rows]
        browser.close()
    finally:
        server.close()
    out.write_text(json.dumps(rows))


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:4]))
