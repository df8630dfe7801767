"""The pictures of the documents, taken of the real page.

Run ``make pictures`` after a change of the screens (``make pictures ARGS="joints review"`` for
some of them), and look at what git shows as changed. Data and cameras are the same each time.
"""

import argparse
import io
import sys
import tempfile
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import sync_playwright

from app.cli.serve import start_server
from app.server.config import ServeConfig
from app.server.prompt_file import read_prompts
from model.core.files import static_assets
from sessions import commands as cmd
from sessions.store import Store
from tests.accepted import BEGIN, accept, cupboard
from tests.browser.browsing import (
    CHROMIUM_FLAGS,
    PAGE_TIMEOUT,
    SceneTab,
    Tab,
    find_chromium,
    wait_until,
)
from tests.browser.film import Film
from tests.raw_scans import raw_scan

EXAMPLES = static_assets() / "examples"
SIZE = (1400, 850)
SCENE_SIZE = (1440, 900)
OUT = Path(__file__).parents[2] / "docs" / "pictures"
LONG = 900.0
"""Seconds for what takes longest: predicting a whole scene on a busy machine."""

DOOR, DRAWER, KNOB = (-0.05, -0.3235, 0.5), (0.15, -0.335, 0.06), (-0.2518, -0.3616, 0.8229)
DOOR_CORNERS = (-0.295, -0.335, 0.755), (0.295, -0.335, 0.20)
CLOCK = (0.0, -0.335, 0.835)
OPEN = {"door 1": 85, "door 5": 85, "drawer 2": 110, "drawer 3": 170, "drawer 4": 240}
"""How far the cabinet's parts are open, in degrees and millimetres."""


class Taking:
    """A browser, the servers behind it, and where the pictures go."""

    def __init__(self, chromium: Any, out: Path, names: set[str], work: Path) -> None:
        self._chromium, self._out, self._names, self._work = chromium, out, names, work
        self._tabs: list[Tab] = []

    def open(
        self,
        *paths: Path,
        kind: type[Tab] = Tab,
        size: tuple[int, int] = SIZE,
        reflections: bool = True,
        before: Callable[[Path], tuple[Path, ...]] = lambda _: (),
        **settings: Any,
    ) -> Tab:
        """A server of its own, and a page of it; what is decided ``before`` in its workspace."""
        workspace = Path(tempfile.mkdtemp(dir=self._work))
        paths = (*paths, *before(workspace))
        server = start_server(
            ServeConfig(paths=paths, workspace=workspace, port=0, user="annotator", **settings)
        )
        page = self._chromium.new_page(viewport={"width": size[0], "height": size[1]})
        page.set_default_timeout(PAGE_TIMEOUT)
        memory = "\\n\\n\\n" + ("" if reflections else "plain") + "\\n\\nyes"  # without the tour
        page.add_init_script(f"localStorage.setItem('viser-user:artiworld', '{memory}')")
        page.goto(server.url)
        tab = kind(page, server)
        self._tabs.append(tab)
        tab.ready()
        if tab.object is not None:
            wait_until(lambda: not tab.object.busy, "the object is encoded", LONG)
        free_of_notes(tab)  # viser's own: that there is no GPU
        return tab

    def close(self) -> None:
        """End what is open: pages that draw without a GPU are in each other's way."""
        while self._tabs:
            tab = self._tabs.pop()
            tab.page.close()
            tab.server.close()

    def wanted(self, *names: str) -> bool:
        """Whether any of these is to be taken."""
        return bool(self._names & set(names))

    def take(self, tab: Tab, name: str, box: tuple[int, int, int, int] | None = None) -> None:
        """Save the page, or a part of it (left, top, right, bottom), with 256 colours."""
        if not self.wanted(name):
            return
        tab.page.wait_for_timeout(2500)  # the last frames, drawn without a GPU
        picture = (
            Image.open(io.BytesIO(tab.page.screenshot(timeout=1000 * LONG)))
            .convert("RGB")
            .crop(box)
        )
        path = self._out / f"{name}.png"
        # Of Pillow's ways to choose colours the one that keeps thin bright lines.
        few = picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
        few.save(path, optimize=True)
        print(f"{path} {path.stat().st_size // 1024} kB", flush=True)

    def save_film(self, film: Film, name: str) -> Path:
        """Write a moving picture among the others."""
        path = self._out / f"{name}.webp"
        film.save(path)
        return path


def look(tab: Tab, position: tuple[float, ...], at: tuple[float, ...]) -> None:
    """Put the camera there."""
    tab.camera_at_rest()
    tab.app.tab.client.camera.position, tab.app.tab.client.camera.look_at = position, at
    tab.camera_at_rest()
    # The page says where it is, before places in the picture are computed.
    tab.page.wait_for_timeout(800)


def away(tab: Tab) -> None:
    """The pointer off the picture, so that no preview is in it."""
    tab.page.mouse.move(5, SIZE[1] - 5)
    tab.page.wait_for_timeout(400)


def free_of_notes(tab: Tab) -> None:
    """Close what was told."""
    close = "document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"

    def gone() -> bool:
        tab.page.evaluate(close)  # some go by themselves meanwhile
        tab.page.wait_for_timeout(700)
        return not tab.page.locator(".mantine-Notification-root").count()

    wait_until(gone, "no notes")


def cabinet(taking: Taking) -> None:
    """The bundled cabinet: proposed, and with its joints open."""
    if not taking.wanted("all_parts", "joints", "review"):
        return
    tab = taking.open()  # as `make run` does: cabinet is the first of the examples
    look(tab, (-1.05, -2.5, 1.45), (0.02, -0.05, 0.36))
    if taking.wanted("all_parts"):
        tab.button("All parts").click()
        wait_until(lambda: len(tab.document.parts) == 6, "five parts are proposed", LONG)
        tab.settled()
        away(tab)
        free_of_notes(tab)
        taking.take(tab, "all_parts", (305, 165, 975, 665))
        tab.app.tab.act(tab.app.commands.undo)
        wait_until(lambda: not tab.document.prompts, "undo")
    if not taking.wanted("joints", "review"):
        return
    told = read_prompts(EXAMPLES / "cabinet.prompts.json")
    tab.object.do(cmd.SetCategory(told.category), "annotator")
    for part, name in told.names.items():
        tab.object.do(cmd.AddPart(part, name), "annotator")
    for click in told.prompts.clicks:
        tab.object.do(cmd.AddClick(click), "annotator")
    tab.settled()
    tab.button("Predict joints (P)").first.click()
    wait_until(lambda: tab.document.tree is not None, "joints", LONG)
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    wait_until(lambda: tab.object.validation.report, "a verdict", LONG)
    wait_until(lambda: not tab.object.busy, "the sweeps are done", LONG)
    tab.page.locator('[data-press="joint"][value="link_1"]').click()
    for count, (part, far) in enumerate(OPEN.items(), start=1):
        unit = "°" if part.startswith("door") else "mm"
        tab.set_slider(f"{part} [{unit}]", far)
        wait_until(lambda count=count: len(tab.app.motion.q) == count, f"{part} is open")
    look(tab, (-1.0, -2.4, 1.4), (0.02, -0.2, 0.36))
    tab.page.evaluate("document.activeElement?.blur()")
    top = "document.querySelectorAll('.mantine-ScrollArea-viewport').forEach(v => v.scrollTop = 0)"
    tab.page.evaluate(top)
    away(tab)
    free_of_notes(tab)
    taking.take(tab, "joints")
    tab.step("Review")
    away(tab)
    taking.take(tab, "review")


def oven(taking: Taking) -> None:
    """The bundled scan of an oven: preview, rectangle, clicks and tools."""
    names = ("preview", "rectangle", "same_shape", "annotate", "lasso")
    if not taking.wanted(*names):
        return
    tab = taking.open(EXAMPLES / "oven_scan.ply")
    look(tab, (-1.0, -2.05, 1.3), (0.0, -0.05, 0.45))
    front = (310, 120, 1050, 720)  # the oven between rail and panel
    if taking.wanted("preview"):
        x, y = tab.pixel(DOOR)
        tab.page.mouse.move(x - 3, y)
        tab.page.mouse.move(x, y)
        shown = tab.app.tab.client.scene.get_handle_by_name
        wait_until(lambda: shown("/hover/gained"), "dots under the pointer")
        taking.take(tab, "preview", front)
    if taking.wanted("rectangle"):
        rectangle(taking, tab)
    if not taking.wanted("same_shape", "annotate", "lasso"):
        return
    for part, (name, place) in enumerate((("door", DOOR), ("drawer", DRAWER)), start=1):
        tab.key(str(part))
        wait_until(lambda part=part: tab.selection.part == part, "the key chooses the part")
        tab.prompt(place)
        tab.button(name).click()
        wait_until(lambda part=part: part in tab.document.part_names, "it has a name")
        tab.page.evaluate("document.activeElement?.blur()")
    tab.key("3")
    wait_until(lambda: tab.selection.part == 3, "part 3")
    tab.prompt(KNOB)
    tab.key("z")
    wait_until(lambda: tab.app.pointing.tools.finds, "similar parts")
    tab.key("Enter")
    wait_until(lambda: len(tab.document.parts) == 9, "all six knobs")
    tab.settled()
    away(tab)
    free_of_notes(tab)
    taking.take(tab, "same_shape", front)
    taking.take(tab, "annotate")
    if taking.wanted("lasso"):
        lasso(taking, tab)


def prepare(taking: Taking) -> None:
    """The bundled oven on a table, as it comes, shown levelled with the table in grey."""
    if not taking.wanted("prepare"):
        return
    scan = Path(tempfile.mkdtemp()) / "oven.ply"
    raw_scan(scan, seed=3, scale=1.0)
    tab = taking.open(scan)
    wait_until(lambda: tab.selection.step == "Prepare", "a tilted scan is noticed", LONG)
    tab.camera_at_rest()
    away(tab)
    free_of_notes(tab)
    taking.take(tab, "prepare")


def rectangle(taking: Taking, tab: Tab) -> None:
    """Two corners of the oven's door, the second still under the pointer."""
    for armed in ("cut", "rectangle"):
        tab.key("k")
        wait_until(lambda armed=armed: tab.app.pointing.armed == armed, armed)
    tab.click3d(DOOR_CORNERS[0])
    tab.page.wait_for_timeout(1500)
    x, y = tab.pixel(DOOR_CORNERS[1])
    tab.page.mouse.move(x - 3, y)
    tab.page.mouse.move(x, y)
    taking.take(tab, "rectangle", (254, 75, 1056, 845))
    tab.key("Escape")
    wait_until(lambda: tab.app.pointing.armed == "", "back to clicks")


def lasso(taking: Taking, tab: Tab) -> None:
    """Round the oven's clock, the button still down."""
    tab.key("9")
    wait_until(lambda: tab.selection.part == 9, "part 9")
    tab.key("l")
    wait_until(lambda: tab.app.pointing.tool == "lasso", "the lasso")
    x, y = tab.pixel(CLOCK)
    turns = np.linspace(0, 2 * np.pi, 40)
    ring = [(x + 44 * np.cos(t), y + 27 * np.sin(t) - 6 * np.cos(t)) for t in turns]
    tab.page.mouse.move(*ring[0])
    tab.page.mouse.down()
    for place in ring[1:]:
        tab.page.mouse.move(*place)
    taking.take(tab, "lasso", (310, 120, 1050, 850))
    tab.page.mouse.up()


def scene(taking: Taking) -> None:
    """The bundled room: all predicted, the sure ones accepted, a chair chosen."""
    if not taking.wanted("scene"):
        return
    tab = taking.open(
        kind=SceneTab,
        size=SCENE_SIZE,
        scene=EXAMPLES / "home.scene.json",
        assets=(EXAMPLES,),
    )
    scene_workspace = tab.scene_workspace
    wait_until(
        lambda: (
            scene_workspace.wanted()
            and all(w.document.tree is not None for w in scene_workspace.wanted())
        ),
        "all are predicted",
        LONG,
    )
    tab.button("Gallery or list").click()
    tab.page.locator(".aw-bulk button").first.click()
    tab.page.get_by_label("Minimum confidence in percent").fill("50")
    tab.button("Accept those that passed the checks").click()
    tab.page.keyboard.press("Escape")
    wait_until(
        lambda: scene_workspace.accepting.waiting or "accept" in scene_workspace.busy, "it begins"
    )
    wait_until(
        lambda: not scene_workspace.accepting.waiting and "accept" not in scene_workspace.busy,
        "decided",
        LONG,
    )
    tab.app.tab.act(lambda: tab.scene.choice.choose("chair at the desk"))
    wait_until(lambda: tab.scene.choice.selected == "chair at the desk", "the chair is chosen")
    look(tab, (3.0, -5.9, 4.8), (0.1, 0.0, 0.2))
    away(tab)
    free_of_notes(tab)
    taking.take(tab, "scene")


FILM_SIZE = (1120, 640)


def demo(taking: Taking) -> None:
    """The moving picture: the raw scan of a stove, from its file to the accepted asset."""
    if not taking.wanted("demo"):
        return
    scan = Path(tempfile.mkdtemp()) / "stove.ply"
    scanned = raw_scan(scan, scale=1.0)
    tab = taking.open(scan, size=FILM_SIZE, reflections=False)  # many frames: each is drawn faster
    film = Film(tab.page)
    wait_until(lambda: tab.selection.step == "Prepare", "a tilted scan is noticed", LONG)
    tab.camera_at_rest()
    film.take("1. Open a raw scan; Enter levels it and leaves the table out", 1500)
    tab.key("Enter")
    wait_until(lambda: tab.selection.step == "Annotate", "it is levelled", LONG)
    tab.ready()
    look(tab, (-1.0, -2.05, 1.3), (0.0, -0.05, 0.45))
    free_of_notes(tab)
    caption = "2. Pick a name and click: the part is cut out"
    film.take(caption, 900)
    tab.key("Shift+0")
    wait_until(lambda: tab.document.category, "the suggested category")
    frame = np.asarray(tab.document.frame.object_from_read) @ scanned
    for key, place in (("Shift+1", DOOR), ("Shift+2", DRAWER), ("Shift+4", KNOB)):
        tab.key(key)
        there = frame[:3, :3] @ place + frame[:3, 3]
        film.take(caption, 500, tab.pixel(there))
        tab.prompt(there)
        free_of_notes(tab)
        film.take(caption, 500, tab.pixel(there), pressed=True)
    tab.key("z")
    wait_until(lambda: tab.app.pointing.tools.finds, "similar parts", LONG)
    caption = "3. Same shape (Z) finds the other knobs; Enter takes them"
    film.take(caption, 900)
    tab.key("Enter")
    wait_until(lambda: len(tab.document.parts) == 9, "all six knobs")
    tab.settled()
    free_of_notes(tab)
    film.take(caption, 900)
    film_joints(tab, film)
    path = taking.save_film(film, "demo")
    print(f"{path} {path.stat().st_size // 1024} kB", flush=True)


def film_joints(tab: Tab, film: Film) -> None:
    """From the parts to the accepted asset."""
    tab.key("p")
    wait_until(lambda: tab.document.tree is not None, "joints", LONG)
    wait_until(lambda: tab.selection.step == "Joints", "the joints are shown")
    wait_until(lambda: not tab.object.busy, "the sweeps are done", LONG)
    free_of_notes(tab)
    caption = "4. Predict the joints (P); they move at once"
    film.take(caption, 900)
    moving = [joint for joint in tab.document.tree.joints if joint.moves]
    for share in 0.45 * (1 - np.cos(np.linspace(0, 2 * np.pi, 17))):

        def pose(share: float = float(share)) -> None:
            for joint in moving:
                tab.app.motion.set_q(joint.name, share * (joint.upper or 1.0))

        tab.app.tab.act(pose)
        tab.drawn()
        film.take(caption, 120)
    tab.step("Review")
    wait_until(lambda: tab.object.validation.report, "a verdict", LONG)
    free_of_notes(tab)
    caption = "5. Look at the checks, accept (Y), export"
    film.take(caption, 1200)
    while tab.document.review.state != "accepted":  # a warning wants Y again
        tab.wait_seen()
        tab.page.locator("canvas").first.focus()
        tab.key("y")
        tab.page.wait_for_timeout(3000)
        wait_until(lambda: not tab.object.busy and not tab.object.being_accepted, "an answer", LONG)
    tab.drawn()
    free_of_notes(tab)
    film.take(caption, 2000)


def project(taking: Taking) -> None:
    """The project page: objects of two weeks, accepted by two people, and some to do."""
    if not taking.wanted("project"):
        return

    def work(workspace: Path) -> tuple[Path, ...]:
        store, today = Store(workspace), (datetime.now(UTC) - BEGIN).days
        folder = Path(tempfile.mkdtemp(dir=workspace.parent))
        for number, days in enumerate((12, 12, 11, 8, 8, 7, 7, 6, 5, 2, 1, 1, 0, 0)):
            path = folder / f"cabinet {number + 1}.ply"
            accept(
                store, path, cupboard("StorageFurniture"), ("ann", "ben")[number % 2], today - days
            )
        store.close()
        return EXAMPLES, folder

    tab = taking.open(size=SCENE_SIZE, reflections=False, before=work)
    tab.page.get_by_role("button", name="Project", exact=True).click()
    tab.page.locator(".aw-project ul").wait_for()
    taking.take(tab, "project", (269, 157, 1171, 743))


PICTURES = "demo all_parts joints review preview rectangle same_shape annotate lasso scene"
NAMES = (*PICTURES.split(), "prepare", "project")
PLAYS: tuple[Callable[[Taking], None], ...] = (demo, cabinet, oven, scene, prepare, project)


def main() -> None:
    """Command line of this module."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"of {', '.join(NAMES)}")
    parser.add_argument("--out", type=Path, default=OUT)
    arguments = parser.parse_args()
    unknown = sorted(set(arguments.names) - set(NAMES))
    if unknown:
        parser.error(f"no picture is called {', '.join(unknown)}; there are {', '.join(NAMES)}")
    path = find_chromium()
    if path is None:
        sys.exit("Chromium is not installed: apt-get install chromium")
    arguments.out.mkdir(parents=True, exist_ok=True)
    with sync_playwright() as playwright, tempfile.TemporaryDirectory() as work:
        chromium = playwright.chromium.launch(executable_path=path, args=list(CHROMIUM_FLAGS))
        taking = Taking(chromium, arguments.out, set(arguments.names or NAMES), Path(work))
        for play in PLAYS:
            play(taking)
            taking.close()
        chromium.close()


if __name__ == "__main__":
    main()
