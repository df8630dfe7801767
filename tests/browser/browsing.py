"""Driving the real page: pixels of 3D points, widgets by label, waiting on the server's state."""

import re
import shutil
import time
from collections.abc import Mapping
from typing import Any, Self

import numpy as np

from app.server.page import set_page_state
from tests.builders import wait_until

CHROMIUM_FLAGS = (
    "--headless=new",
    "--no-sandbox",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-gpu-compositing",  # the panels; drawing them through WebGL's emulation costs more
    "--disable-quic",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--no-first-run",
)
SHOWN = "() => window.__artiworld?.get().shown"
"""Whether the page has drawn something of ours; until then all of it is hidden."""
COARSE = "/?fixedDpr=0.2"
"""viser draws a fifth of the pixels each way, places stay what they are: there is no GPU here."""
FEWER_FRAMES = """(() => {
  const frame = window.requestAnimationFrame.bind(window), cancelled = new Set();
  let awake = 0;
  window.wakeFrames = () => { awake = performance.now() + 500; };
  for (const kind of ["pointerdown", "pointermove", "wheel", "keydown"])
    window.addEventListener(kind, window.wakeFrames, { capture: true, passive: true });
  window.requestAnimationFrame = (draw) => {
    const id = setTimeout(() => frame((t) => cancelled.delete(id) || draw(t)),
      performance.now() < awake ? 70 : 300);
    return id;
  };
  window.cancelAnimationFrame = (id) => { clearTimeout(id); cancelled.add(id); };
})()"""
"""viser draws as often as it can, which takes a whole core without a GPU: here a few times a
second, more often after input and where a test waits for frames."""
PAGE_TIMEOUT = 300_000
"""Milliseconds that the page may take for anything; it draws in software on busy cores."""

_PROJECT = """(p) => {
  const m = window.__viserMutable, cam = m.camera, box = m.canvas.getBoundingClientRect();
  cam.updateMatrixWorld();
  const v = cam.position.clone().set(p[0], p[1], p[2]);
  const root = m.nodeRefFromName[''];
  if (root) { root.updateWorldMatrix(true, false); v.applyMatrix4(root.matrixWorld); }
  v.project(cam);
  return [box.left + (v.x + 1) / 2 * box.width, box.top + (1 - v.y) / 2 * box.height];
}"""


_FRAMES = """(count) => new Promise((done) => {
  const next = () => {
    window.wakeFrames?.();
    return count-- > 0 ? requestAnimationFrame(next) : done();
  };
  next();
})"""
_RESTING = """(frames) => new Promise((done) => {
  const m = window.__viserMutable, cam = m.camera;
  let before = "", still = 0;
  const look = () => {
    window.wakeFrames?.();
    const box = m.canvas.getBoundingClientRect();
    const now = [...cam.position, ...cam.quaternion, ...cam.projectionMatrix.elements,
      box.left, box.width, box.height].join();
    still = now === before ? still + 1 : 0;
    before = now;
    if (still < frames) return requestAnimationFrame(look);
    const eye = cam.position.clone(), root = m.nodeRefFromName[""];
    done((root ? eye.applyMatrix4(root.matrixWorld.clone().invert()) : eye).toArray());
  };
  look();
})"""
"""Where the camera is once it and the picture's place stay the same for some frames."""


def page_at_rest(page: Any) -> Any:
    """(3,) where the page has the camera once all that the server sent with it was drawn."""
    page.wait_for_selector(":root.aw-begun", state="attached")  # until then a click hits nothing
    page.wait_for_function("() => window.__viserPointer?.hasSceneClickFilter()")
    return np.array(page.evaluate(_RESTING, 4))


def log_in(page: Any, server: Any, name: str, password: str) -> None:
    """Log in on the page that an unknown visitor gets, and open the application."""
    page.wait_for_url("**/login")
    page.get_by_label("Name").fill(name)
    page.get_by_role("textbox", name="Password").fill(password)
    page.get_by_role("button", name="Log in").click()
    page.wait_for_url("**/", wait_until="commit")  # it loads at full size, which nobody waits for
    page.goto(f"{server.url}{COARSE}")


def find_chromium() -> str | None:
    """Where a Chromium is, or None."""
    names = ("chromium", "chromium-browser", "google-chrome")
    return next((path for path in map(shutil.which, names) if path), None)


class Tab:
    """One page and the server's application behind it."""

    def __init__(self, page: Any, server: Any) -> None:
        self.page = page
        self.server = server

    @property
    def app(self) -> Any:
        """The newest application of the server."""
        return self.server.apps[max(self.server.apps)]

    @property
    def selection(self) -> Any:
        return self.app.tab.selection

    @property
    def object(self) -> Any:
        return self.selection.object

    @property
    def document(self) -> Any:
        return self.object.document

    def ready(self) -> Self:
        """Wait for the object's picture and for clicks to be heard."""
        wait_until(lambda: self.server.apps, "the server sees the tab")
        wait_until(lambda: self.app.drawing.drawn, "the object's picture is sent")
        self.wait_node("/scan")
        self.camera_at_rest()
        return self

    @property
    def places(self) -> int:
        """How many of the places that were asked for are marked in the picture."""
        handle = self.app.tab.client.scene.get_handle_by_name
        return sum(handle(f"/place/{k}") is not None for k in range(3))

    def click_places(self, *places: Any) -> None:
        """Click on 3D points that were asked for, one after the other."""
        for k, place in enumerate(places):
            wait_until(lambda k=k: self.places == k, "the earlier places are taken")
            self.click3d(place)

    def wait_node(self, name: str) -> None:
        self.page.wait_for_function(
            "(n) => { const s = window.__viserSceneTree?.getState?.(); return !!s && !!s[n]; }",
            arg=name,
        )

    def drawn(self) -> None:
        """Wait until the page shows what came of all that was done so far."""
        tab, asked = self.app.tab, []
        tab.act(lambda: asked.append(tab.drawings))  # after what was asked for before
        wait_until(lambda: asked, "earlier actions")

        def sent() -> bool:
            tab.invalidate()
            return tab.drawings > asked[0] + 1  # one that may have begun before, and one more

        wait_until(sent, "the newest state is sent")
        set_page_state(tab.client, drawings=asked[0])
        self.page.wait_for_function("(n) => window.__artiworld?.get().drawings === n", arg=asked[0])
        self.frames(2)

    def frames(self, count: int) -> None:
        """Wait until the page has drawn some frames."""
        self.page.evaluate(_FRAMES, count)

    def camera_at_rest(self) -> Any:
        """(3,) where the camera is once the page has it where the server does, and it rests."""
        view = self.app.tab.client.camera

        def rests() -> bool:
            return np.allclose(page_at_rest(self.page), view.position, atol=1e-3)

        wait_until(rests, "the camera rests")
        return np.asarray(view.position)

    def pixel(self, point: Any) -> tuple[float, float]:
        """Where a 3D point is on the page."""
        x, y = self.page.evaluate(_PROJECT, [float(v) for v in point])
        return x, y

    def click3d(self, point: Any, modifiers: tuple[str, ...] = ()) -> None:
        """Click on a 3D point in the picture."""
        x, y = self.pixel(point)
        for key in modifiers:
            self.page.keyboard.down(key)
        self.page.mouse.click(x, y)
        for key in modifiers:
            self.page.keyboard.up(key)

    def drag_box(self, low: Any, high: Any) -> None:
        """Drag a box between two corners (x, y) on the page, with Alt."""
        mouse = self.page.mouse
        self.page.keyboard.down("Alt")
        mouse.move(*low)
        mouse.down()
        mouse.move(*high, steps=8)
        mouse.up()
        self.page.keyboard.up("Alt")

    def prompt(self, point: Any, modifiers: tuple[str, ...] = ()) -> None:
        """Click and wait until the labels have followed."""
        before = len(self.document.prompts)
        self.click3d(point, modifiers)
        wait_until(lambda: len(self.document.prompts) == before + 1, "the click is a prompt")
        self.settled()

    def settled(self) -> None:
        """Wait until the labels belong to the prompts."""
        wait_until(lambda: self.document.segmentation_current, "labels follow the prompts")
        wait_until(
            lambda: not self.document.prompts or self.object.labels is not None, "labels shown"
        )

    def key(self, name: str) -> None:
        """Press a key with the canvas in focus."""
        self.page.keyboard.press(name)

    def wait_for_keyboard(self) -> None:
        """Wait until no field takes the keys: a list or a number gives them back."""
        self.page.wait_for_function("() => !document.activeElement?.matches('input, textarea')")

    def wait_seen(self) -> None:
        """Wait until what is shown was there for long enough to be decided on."""
        wait_until(lambda: self.app.guard.long_enough(time.monotonic()), "it was seen")

    def row(self, label: str) -> Any:
        """The row of a labelled widget."""
        return self.page.locator(
            f'xpath=//label[normalize-space()="{label}"]'
            '/ancestor::div[contains(@class,"mantine-Flex-root")][1]'
        ).first

    def field(self, label: str, index: int = 0) -> Any:
        return self.row(label).locator("input, textarea").nth(index)

    def type_at_once(self, texts: Mapping[str, str]) -> None:
        """Fill several fields without a pause between them, as a form filler does."""
        fields = [[self.field(label).element_handle(), text] for label, text in texts.items()]
        self.page.evaluate(
            """(fields) => {
                for (const [field, text] of fields) {
                    const { set } = Object.getOwnPropertyDescriptor(
                        Object.getPrototypeOf(field), "value");
                    set.call(field, text);
                    field.dispatchEvent(new Event("input", { bubbles: true }));
                }
            }""",
            fields,
        )

    def set_number(self, label: str, value: float, index: int = 0) -> None:
        self.drawn()  # what the field is to show would replace what is typed
        box = self.field(label, index)
        box.fill(str(value))
        box.press("Enter")

    def set_slider(self, label: str, value: float) -> None:
        box = self.row(label).locator("input.mantine-NumberInput-input").last
        box.fill(str(value))
        box.press("Enter")

    def choose(self, label: str, option: str) -> None:
        from playwright.sync_api import TimeoutError as NotInTime

        wanted = self.page.get_by_role("option", name=option, exact=True)
        for tries_left in reversed(range(6)):
            self.field(label).click()
            try:
                wanted.click(timeout=10_000)
                break
            except NotInTime:  # a folder that still unfolds moves the box from under its list
                if not tries_left:
                    raise
        self.wait_for_keyboard()

    def button(self, text: str) -> Any:
        return self.page.get_by_role("button", name=text, exact=True)

    def step(self, name: str) -> None:
        """Annotate, Joints or Review."""
        # The dot of a step that asks for a look comes and goes.
        label = re.compile(rf"^(● )?{re.escape(name)}$")
        self.page.get_by_role("button", name=label).first.click()
        wait_until(lambda: self.selection.step == name, f"the {name} step")
        self.drawn()


class SceneTab(Tab):
    """A tab that shows a scene."""

    @property
    def scene(self) -> Any:
        return self.app.scene

    @property
    def scene_workspace(self) -> Any:
        return self.server.app_state.scene

    def ready(self) -> Self:
        wait_until(lambda: self.server.apps, "the server sees the tab")
        wait_until(lambda: self.scene_workspace.scene is not None, "the scene is read")
        self.wait_node("/world/ground")
        self.page.wait_for_function(SHOWN)
        self.camera_at_rest()
        return self

    def save(self) -> Any:
        """Save the scene once the parts of its objects are cut; what was saved."""
        workspace = self.scene_workspace
        wait_until(lambda: all(w.drawn is not None for w in workspace.wanted()), "its parts")
        self.button("Save scene").click()
        return wait_until(lambda: workspace.document.saved, "saved")

    def status(self, id: str) -> str:
        return self.scene_workspace.status(self.scene_workspace.items[id])
