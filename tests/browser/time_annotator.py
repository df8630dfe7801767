"""Time a person from the file to the accepted asset, in the real page.

``python -m tests.browser.time_annotator [FOLDER]`` takes the bundled oven scan at a random rotation
and scale on a table, and, from FOLDER, real crops of ScanNet. A script makes each action in
Chromium and waits for the page's answer as a person would. A person's own time is that of the
keystroke-level model (Card, Moran and Newell, 1980): a key 0.28 s, pointing and clicking 1.1 s, and
1.35 s of thinking before each decision. It passes before the action in real time, while page and
server go on with what they do; as in the model, only what one must wait for beyond it counts.
"""

import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from app.viewer.panels.part_list import names_for
from model.validation.report import Severity
from tests.browser.browsing import (
    CHROMIUM_FLAGS,
    COARSE,
    FEWER_FRAMES,
    PAGE_TIMEOUT,
    Tab,
    find_chromium,
    wait_until,
)
from tests.raw_scans import raw_scan

KEY, POINT, MENTAL = 0.28, 1.1, 1.35
"""Seconds of the keystroke-level model."""
REASON = "looks right"
"""What is typed where the checks find an error."""


@dataclass
class Times:
    """Actions of a person and seconds.

    Attributes:
        keys, points, thoughts: counts.
        waited: phase → seconds that the person waited for page and server.
    """

    keys: int = 0
    points: int = 0
    thoughts: int = 0
    waited: dict[str, float] = field(default_factory=dict)
    _since: float = field(default_factory=time.perf_counter)
    _person: float = 0.0

    def act(self, *, keys: int = 0, points: int = 0, thoughts: int = 0) -> None:
        """Let the time pass that a person takes for some actions."""
        self.keys, self.points = self.keys + keys, self.points + points
        self.thoughts += thoughts
        time.sleep(KEY * keys + POINT * points + MENTAL * thoughts)

    def phase(self, name: str) -> None:
        """End a phase that began with the one before."""
        now, before, self._person = time.perf_counter(), self._person, self.person
        self.waited[name] = now - self._since - (self._person - before)
        self._since = now

    @property
    def person(self) -> float:
        """Seconds of the person."""
        return KEY * self.keys + POINT * self.points + MENTAL * self.thoughts


@dataclass
class Annotator:
    """Acts on a tab, and counts."""

    tab: Tab
    times: Times

    def key(self, name: str, *, think: bool = True) -> None:
        """Press a key."""
        self.times.act(keys=1 + name.count("+"), thoughts=int(think))
        self.tab.key(name)

    def click(self, point: Any, part: int) -> None:
        """Choose a part by its key or its row, and click on it."""
        tab = self.tab
        if part != tab.selection.part:
            if part < 10:
                self.key(str(part), think=False)
            else:  # as its row in the list does
                self.times.act(points=1)
                tab.app.tab.act(lambda: tab.selection.choose_part(part))
            wait_until(lambda: tab.selection.part == part, f"part {part}")
        self.times.act(points=1, thoughts=1)
        tab.prompt(point)

    def name(self, name: str) -> None:
        """Name the chosen part by its button's key."""
        number = 1 + names_for(self.tab.app.annotate.likely_category).index(name)
        self.key(f"Shift+Digit{number}")
        wait_until(lambda: self.tab.document.part_names.get(self.tab.selection.part) == name, name)

    def take_category(self, category: str) -> None:
        """Take the guess by the file's name with its key."""
        self.tab.button(f"{category}?").wait_for()
        self.key("Shift+Digit0")
        wait_until(lambda: self.tab.document.category == category, category)

    def accept(self, *, saved: bool = True) -> None:
        """Press Y; again after a warning was shown; with a reason after an error.

        Args:
            saved: whether the person waits until the asset is written.
        """
        tab, obj = self.tab, self.tab.object  # the next one may be shown soon
        self.times.act(thoughts=1)  # the joints are looked at while they are checked
        wait_until(lambda: not obj.busy and obj.validation.report, "the checks")
        self.times.phase("checks")
        tab.wait_seen()
        self.key("y", think=False)
        report = obj.validation.report
        if report.severity == Severity.WARNING:
            wait_until(lambda: tab.app.review.validation_list.looked_at(obj), "it was shown")
            tab.wait_seen()
            self.key("y")
        elif report.severity == Severity.ERROR:
            wait_until(lambda: tab.selection.step == "Review", "the reason is asked for")
            tab.drawn()
            self.times.act(keys=len(REASON), points=2, thoughts=1)
            tab.field("Reason for override").fill(REASON)
            tab.field("Reason for override").press("Enter")
            tab.drawn()
            tab.button("Accept anyway (Y)").click()
        wait_until(lambda: obj.document.review.state == "accepted", "accepted")
        if saved:
            wait_until(lambda: obj.document.saved, "saved")


def oven(person: Annotator, source_from_object: np.ndarray) -> None:
    """Level it; click door, drawer and a knob and name them; Z takes the other knobs."""
    tab = person.tab
    wait_until(lambda: tab.selection.step == "Prepare", "a tilted scan is noticed")
    wait_until(lambda: tab.object.preparing.current, "a proposal")
    person.key("Enter")
    wait_until(lambda: tab.selection.step == "Annotate", "annotating")
    wait_until(lambda: tab.object.asset is not None and not tab.object.busy, "it is read")
    tab.drawn()
    tab.camera_at_rest()
    person.times.phase("prepare")
    object_from_source = tab.document.frame.object_from_read @ source_from_object

    def shown(place: tuple[float, float, float]) -> Any:
        return nearest(tab, object_from_source[:3, :3] @ place + object_from_source[:3, 3])

    for part, place in enumerate(((0.2, -0.335, 0.25), (0.2, -0.335, 0.05)), 1):
        person.click(shown(place), part)
        person.name(("door", "drawer")[part - 1])
    knobs = [shown((x, -0.3616, 0.835)) for x in (-0.252, -0.186, -0.12, 0.12, 0.186, 0.252)]
    person.click(knobs[0], 3)
    person.key("z")
    wait_until(lambda: len(tab.document.parts) > 4 and not tab.object.busy, "parts of this shape")
    tab.settled()
    points = tab.object.asset.display_points
    for knob in knobs[1:]:
        part = int(tab.object.labels[(points == knob).all(1).argmax()])
        if part < 3:
            person.click(knob, max(p.id for p in tab.document.parts) + 1)
    person.name("knob")
    person.take_category("Oven")


def refrigerator(person: Annotator, _: Any) -> None:
    """Two doors by a click each."""
    for part, height in ((1, 0.5), (2, 0.93)):
        person.click(frontmost(person.tab, height, 0.5), part)
        person.name("door")
    person.take_category("Refrigerator")


def door(person: Annotator, _: Any) -> None:
    """The leaf by a click."""
    person.click(frontmost(person.tab, 0.5, 0.5), 1)
    person.name("door")
    person.take_category("Door")


def nearest(tab: Tab, point: Any) -> np.ndarray:
    """The displayed point nearest to a place."""
    points = tab.object.asset.display_points
    return points[np.linalg.norm(points - point, axis=1).argmin()]


def frontmost(tab: Tab, height: float, across: float) -> np.ndarray:
    """The displayed point nearest to the viewer at a share of the height and of the width."""
    asset = tab.object.asset
    points, front = asset.display_points, np.asarray(asset.front)
    side = points @ np.cross(front, (0.0, 0.0, 1.0))
    low, high = asset.bounds
    z = low[2] + height * (high[2] - low[2])
    s = side.min() + across * np.ptp(side)
    index = np.flatnonzero((np.abs(points[:, 2] - z) < 0.06) & (np.abs(side - s) < 0.06))
    return points[index[np.argmax(points[index] @ front)]]


def timed(browser: Any, path: Path, annotate: Callable[..., None], frame: Any) -> Times:
    """Take one file to its accepted asset."""
    from app.cli.serve import start_server
    from app.server.config import ServeConfig

    workspace = path.with_name(f"workspace-{path.stem}")
    times = Times()
    server = start_server(ServeConfig(paths=(path,), workspace=workspace, port=0, user="timed"))
    context = browser.new_context(viewport={"width": 1280, "height": 800})
    try:
        context.add_init_script(FEWER_FRAMES)
        page = context.new_page()
        page.set_default_timeout(PAGE_TIMEOUT)
        page.goto(server.url + COARSE)
        tab = Tab(page, server).ready()
        times.phase("open")
        person = Annotator(tab, times)
        annotate(person, frame)
        times.phase("clicks and names")
        person.key("p")
        wait_until(lambda: tab.document.tree, "a kinematic tree")
        times.phase("joints")
        person.accept()
        times.phase("accept")
        joints = tab.document.tree.joints
        print(f"  {len(joints)} joints: {', '.join(j.type for j in joints)}")
        return times
    finally:
        context.close()
        server.close()


def main() -> None:
    """Print a table."""
    from playwright.sync_api import sync_playwright

    given = Path(sys.argv[1]) if len(sys.argv) > 1 else None
    crops = {"i27_refrigerator": refrigerator, "i30_door": door} if given else {}
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        chromium = playwright.chromium.launch(
            executable_path=find_chromium(), args=list(CHROMIUM_FLAGS)
        )
        raw = Path(folder) / "oven.ply"
        tasks: list[tuple[Path, Callable[..., None], Any]] = [(raw, oven, raw_scan(raw, seed=3))]
        for name, annotate in crops.items():
            assert given is not None
            source = given / f"scene0011_00_{name}.ply"
            copy = Path(folder) / source.name
            copy.write_bytes(source.read_bytes())
            tasks.append((copy, annotate, None))
        print("| scan | keys | clicks | decisions | person | waiting | sum |")
        for path, annotate, frame in tasks:
            t = timed(chromium, path, annotate, frame)
            waiting = sum(t.waited.values())
            print("  " + ", ".join(f"{k} {v:.1f} s" for k, v in t.waited.items()))
            print(
                f"| {path.stem} | {t.keys} | {t.points} | {t.thoughts} | {t.person:.1f} s "
                f"| {waiting:.1f} s | {t.person + waiting:.1f} s |",
                flush=True,
            )
        chromium.close()


if __name__ == "__main__":
    main()
