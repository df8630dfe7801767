"""A scan of any rotation and scale, on a table, is levelled and cleaned in the browser."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.viewer.words.prepare import APPLY
from tests.browser.browsing import Tab, wait_until
from tests.raw_scans import raw_scan


def up_error(tab: Tab, source_from_object: np.ndarray) -> float:
    """Degrees between the object's +z and the true one."""
    up = source_from_object[:3, 2] / np.linalg.norm(source_from_object[:3, 2])
    turn = tab.document.frame.object_from_read[:3, :3]
    z = (turn @ up)[2] / np.cbrt(np.linalg.det(turn))
    return float(np.degrees(np.arccos(np.clip(z, -1, 1))))


_GROUND = (
    "() => window.__viserMutable.nodeRefFromName['/ground'].quaternion.toArray().map(Math.abs)"
)


def tilt(source_from_object: np.ndarray) -> float:
    """Degrees between the true up direction and the file's +z."""
    up = source_from_object[:3, 2]
    return float(np.degrees(np.arccos(up[2] / np.linalg.norm(up))))


def read(tab: Tab, before: Any) -> Any:
    """Wait until another asset than ``before`` is read, and return it."""
    asset = wait_until(
        lambda: tab.object.asset is not before and not tab.object.busy and tab.object.asset,
        "it is read",
    )
    tab.wait_for_keyboard()
    return asset


def proposed(tab: Tab) -> Any:
    return wait_until(lambda: tab.object.preparing.current, "a proposal")


def shown(tab: Tab, point: np.ndarray) -> tuple[float, float, float]:
    """The displayed point nearest to one of the source."""
    points = tab.object.asset.display_points
    x, y, z = points[np.linalg.norm(points - point, axis=1).argmin()].tolist()
    return x, y, z


def test_one_key_levels_and_cleans_a_raw_scan(start: Any, open_tab: Any, tmp_path: Path) -> None:
    frame = raw_scan(tmp_path / "oven.ply", seed=3)
    tab = open_tab(start(tmp_path / "oven.ply"))
    wait_until(lambda: tab.selection.step == "Prepare", "a tilted scan is noticed")
    tab.page.get_by_text(f"Tilted by {tilt(frame):.0f}°").first.wait_for(timeout=60_000)
    whole = tab.page.locator(f'span[title="{tmp_path / "oven.ply"}"]')
    whole.wait_for(timeout=60_000)
    assert len(whole.inner_text()) <= 44, "the path is shortened, and whole on hovering"
    raw = tab.object.asset
    tab.key("Enter")
    wait_until(lambda: tab.selection.step == "Annotate", "annotating")
    read(tab, raw)
    assert up_error(tab, frame) < 0.5
    true = 220_440
    assert abs(tab.object.asset.element_count - true) < 0.02 * true
    low, high = tab.object.asset.bounds
    np.testing.assert_allclose((low + high)[:2] / 2, 0, atol=0.05 * (high - low).max())
    tab.drawn()
    assert tab.page.evaluate(_GROUND)[3] == pytest.approx(1.0), "the grid lies level below it"
    assert tab.document.label == f"level by {tilt(frame):.0f}°; remove support, outliers"
    prepared = tab.object.asset
    tab.page.keyboard.press("Control+z")
    wait_until(lambda: tab.document.left_out is None, "undone")
    raw = read(tab, prepared)
    tab.page.keyboard.press("Control+Shift+z")
    wait_until(lambda: tab.document.left_out is not None, "done again")
    read(tab, raw)
    assert up_error(tab, frame) < 0.5
    check_strokes_remove_and_restore(tab)


def check_strokes_remove_and_restore(tab: Tab) -> None:
    """Of the raw scan: Delete takes table and strays, boxes take and give back."""
    prepared = tab.object.asset
    tab.page.keyboard.press("Control+z")
    wait_until(lambda: tab.document.left_out is None, "undone")
    raw = read(tab, prepared)
    tab.step("Prepare")
    proposed(tab)
    tab.drawn()
    tab.camera_at_rest()
    tab.key("Delete")
    wait_until(lambda: tab.document.left_out is not None, "table and strays are removed")
    asset = read(tab, raw)
    before = tab.document.left_out.count
    box = tab.page.locator("canvas").first.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    corners = (x - 60, y - 60), (x + 60, y + 60)
    tab.drag_box(*corners)
    wait_until(lambda: tab.document.left_out.count > before, "the box removes")
    asset = read(tab, asset)
    less = tab.document.left_out.count
    tab.page.keyboard.down("Shift")
    tab.drag_box(*corners)
    tab.page.keyboard.up("Shift")
    wait_until(lambda: tab.document.left_out.count < less, "with Shift it restores")
    read(tab, asset)
    tab.button("Restore").click()
    wait_until(lambda: tab.document.left_out is None, "all is back")


def test_up_by_floor_and_size_by_length(start: Any, open_tab: Any, tmp_path: Path) -> None:
    frame = raw_scan(tmp_path / "oven.ply", seed=5, scale=2.0)
    tab = open_tab(start(tmp_path / "oven.ply"))
    wait_until(lambda: tab.selection.step == "Prepare", "a tilted scan is noticed")
    proposed(tab)
    tab.drawn()  # the camera looks at what is proposed
    eye = tab.camera_at_rest()
    tab.key("7")
    camera = tab.app.tab.client.camera
    wait_until(lambda: not np.array_equal(camera.position, eye), "another view")
    tab.camera_at_rest()

    def corner(x: float, y: float, z: float = -0.064) -> tuple[float, float, float]:
        return shown(tab, frame[:3, :3] @ [x, y, z] + frame[:3, 3])

    tab.key("k")
    wait_until(lambda: tab.app.pointing.armed == "floor", "the floor is asked for")
    tab.click_places(*(corner(*p) for p in ((-0.6, -0.6), (0.6, -0.6), (0.0, 0.7))))
    wait_until(
        lambda: getattr(tab.object.preparing.current, "up", None) is not None,
        "levelled by the floor",
    )
    tab.drawn()
    tab.camera_at_rest()  # at the new front
    tab.key("m")
    wait_until(lambda: tab.app.pointing.armed == "length", "a length is asked for")
    tab.click_places(corner(-0.5, 0.5), corner(0.5, 0.5))
    tab.page.get_by_text("Length [m]").first.wait_for(timeout=60_000)
    tab.field("Length [m]").fill("1.0")
    before = tab.object.asset
    tab.button("Set").click()
    wait_until(lambda: tab.document.frame.scale != 1.0, "scaled")
    assert tab.document.frame.scale == pytest.approx(0.5, rel=0.05)
    read(tab, before)
    before = tab.object.asset
    tab.key("r")
    wait_until(lambda: tab.document.label.startswith("rotate 90°"), "rotated")
    before = read(tab, before)
    tab.drawn()
    tab.field("Height [m]").fill("0.9")
    tab.button(APPLY).click()  # takes what is in the fields
    wait_until(lambda: tab.selection.step == "Annotate", "annotating")
    assert np.ptp(read(tab, before).bounds[:, 2]) == pytest.approx(0.9, rel=0.05)
