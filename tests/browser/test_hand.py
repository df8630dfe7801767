"""The hand of 3D tools: zoom to the pointer, framing, numbers that are dragged, four views."""

from pathlib import Path
from typing import Any

import numpy as np

from tests.browser.browsing import Tab, wait_until
from tests.browser.objects import write_urdf

DOOR = (0.15, -0.15, 0.2)
_SEEN = """() => [...document.querySelectorAll("#artiworld-sides canvas")].map((c) => {
  const all = c.getContext("2d").getImageData(0, 0, c.width, c.height).data;
  return new Set(new Uint32Array(all.buffer)).size;
})"""
"""How many colors each of the small views has."""


def test_zoom_frame_drag_numbers_and_look_from_four_sides(
    tmp_path: Path, start: Any, open_tab: Any
) -> None:
    tab: Tab = open_tab(start(write_urdf(tmp_path)))
    wait_until(lambda: tab.selection.step == "Joints", "its joints are shown")
    wait_until(tab.object.part_payloads, "the parts as they move")
    tab.wait_node("/part/1")
    zoom_and_frame(tab)
    drag_numbers(tab)
    look_from_four_sides(tab)


def zoom_and_frame(tab: Tab) -> None:
    """The wheel keeps the place under the pointer; a double click frames the door."""
    view, mouse = tab.app.tab.client.camera, tab.page.mouse
    tab.camera_at_rest()
    at, far = tab.pixel((0.28, -0.15, 0.38)), distance(view)
    mouse.move(*at)
    mouse.wheel(0, -400)
    wait_until(lambda: distance(view) < 0.9 * far, "it is nearer")
    tab.camera_at_rest()
    assert np.allclose(tab.pixel((0.28, -0.15, 0.38)), at, atol=12)
    mouse.dblclick(*tab.pixel(DOOR))
    wait_until(lambda: np.allclose(view.look_at, (0.0, -0.14, 0.2), atol=0.02), "the door", 60)
    assert tab.selection.joint.name == "hinge", "its first click chose the joint"
    # In Annotate a click is a prompt: Ctrl says that it is none.
    tab.step("Annotate")
    tab.camera_at_rest()
    far = distance(view)
    mouse.move(*tab.pixel(DOOR))
    mouse.wheel(0, 400)
    wait_until(lambda: distance(view) > 1.1 * far, "it is farther", 60)
    tab.camera_at_rest()
    far = distance(view)
    tab.page.keyboard.down("Control")
    mouse.dblclick(*tab.pixel(DOOR))
    tab.page.keyboard.up("Control")
    wait_until(lambda: distance(view) < 0.9 * far, "nearer to what was hit", 60)
    assert not any(p.part == 1 and hasattr(p, "position") for p in tab.document.prompts)
    tab.step("Joints")


def distance(view: Any) -> float:
    return float(np.linalg.norm(np.subtract(view.position, view.look_at)))


def drag_numbers(tab: Tab) -> None:
    """One drag is one change, with Shift a tenth of it."""
    page, before = tab.page, tab.selection.joint.origin
    for keys, share in (((), 1.0), (("Shift",), 0.1)):
        wait_until(lambda: not tab.object.busy, "the checks, which move the panel's rows")
        tab.drawn()
        page.evaluate("() => document.activeElement?.blur()")  # a field with the caret is typed in
        field = tab.field("Origin [mm]")
        value = float(field.input_value())
        per = 10.0 ** np.floor(np.log10(abs(value) or 1.0)) / 50
        field.scroll_into_view_if_needed()
        box = field.bounding_box()
        page.mouse.move(box["x"] + 10, box["y"] + 8)
        page.mouse.down()
        page.mouse.move(box["x"] + 15, box["y"] + 8)  # from here it counts
        for key in keys:
            page.keyboard.down(key)
        page.mouse.move(box["x"] + 115, box["y"] + 8, steps=5)
        page.mouse.up()
        for key in keys:
            page.keyboard.up(key)
        wanted = (value + 100 * per * share) / 1000
        wait_until(
            lambda wanted=wanted: abs(tab.selection.joint.origin[0] - wanted) < 2e-5, "it moved", 60
        )
    for _ in range(2):
        tab.app.tab.act(tab.app.commands.undo)
    wait_until(lambda: tab.selection.joint.origin == before, "two steps of the history")


def look_from_four_sides(tab: Tab) -> None:
    """Top, front and right stand beside the picture; a click on one looks from there."""
    four = tab.button("Four views")
    four.click()
    wait_until(lambda: min(tab.page.evaluate(_SEEN)) > 20, "three pictures", 60)
    view = tab.app.tab.client.camera
    tab.button("Right view").click()

    def from_the_right() -> bool:
        away = np.subtract(view.position, view.look_at)
        return bool(away[0] > 0.98 * np.linalg.norm(away))

    wait_until(from_the_right, "seen from +x", 60)
    four.click()
    assert tab.page.locator("#artiworld-sides").is_hidden()
