"""The queue as a gallery of hundreds, work on many of them, and the export, in a real browser."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import trimesh

from model.io.assets.reader import load_object
from tests.browser.browsing import Tab, wait_until
from tests.browser.test_urdf import URDF

pytestmark = pytest.mark.browser
MANY = 300


def test_hundreds_are_searched_sorted_changed_and_exported(
    tmp_path: Path, start: Any, open_tab: Any
) -> None:
    trimesh.creation.box(bounds=[[-0.3, -0.13, 0], [0.3, 0.15, 0.4]]).export(tmp_path / "body.ply")
    trimesh.creation.box(bounds=[[0, 0, 0], [0.6, 0.02, 0.4]]).export(tmp_path / "door.ply")
    (tmp_path / "cupboard.urdf").write_text(URDF)
    box = trimesh.creation.box((0.4, 0.3, 0.2)).export(file_type="ply")
    boxes = [tmp_path / f"box_{k:03}.ply" for k in range(MANY)]
    for path in boxes:
        path.write_bytes(box)
    tab: Tab = open_tab(start(tmp_path / "cupboard.urdf", *boxes))
    page, queue = tab.page, tab.server.app_state.queue
    records = {r.name: r.id for r in queue.records()}
    cards = page.locator(".aw-card")
    page.get_by_title("box_003: to do").wait_for()
    assert cards.count() < 40, "only what is seen is there"

    # The gallery: thumbnails come from a worker; search, selection, and an action on all found.
    page.get_by_role("button", name="Gallery or list").click()
    page.wait_for_function("() => document.querySelectorAll('.wide .drawn').length > 2")
    assert list((Path(tab.server.config.workspace) / "thumbnails").glob("*.webp"))
    page.get_by_label("Search", exact=True).fill("box_29")
    wait_until(lambda: cards.count() == 10, "ten are found")
    page.get_by_label("Select box_290").check()
    page.get_by_role("button", name="Select all").click()
    page.get_by_text("10 selected").wait_for()
    page.locator(".aw-bulk input[list]").fill("Box")
    page.get_by_role("button", name="Set the category of the selected objects").click()
    wait_until(lambda: sum(r.category == "Box" for r in queue.records()) == 10, "all have it")
    page.get_by_label("Search", exact=True).fill("")
    page.get_by_label("Sort by").select_option("category")
    page.get_by_title("box_299: in progress").wait_for()

    # Objects without parts are skipped with the reason; by the keyboard alone one is opened.
    page.get_by_role("button", name="Predict", exact=True).click()
    page.get_by_text("10: no parts yet", exact=False).wait_for()
    card = page.locator(".aw-open", has_text="box_295")
    page.get_by_label("Select box_294").focus()
    page.keyboard.press("Tab")
    assert card.evaluate("(e) => getComputedStyle(e).outlineStyle") == "solid", "focus shows"
    page.keyboard.press("Enter")
    wait_until(lambda: tab.object.record.id == records["box_295"], "Enter opens it")
    page.locator(".wide").wait_for(state="detached")

    # An accepted object is exported to a folder that other software can read.
    tab.app.tab.act(lambda: tab.app.queue.open(records["cupboard"]))
    wait_until(lambda: tab.object.record.id == records["cupboard"], "the cupboard")
    wait_until(lambda: tab.object.validation.report, "the checks are done")
    tab.app.tab.act(lambda: tab.app.review.accept())
    wait_until(lambda: tab.object.validation.report and not tab.object.busy, "decided")
    if tab.document.review.state != "accepted":  # its warnings were shown now
        tab.app.tab.act(lambda: tab.app.review.accept())
    cupboard = tab.server.app_state.object(records["cupboard"])
    wait_until(lambda: cupboard.document.saved is not None, "saved")
    tab.app.tab.act(lambda: tab.app.queue.open(records["cupboard"]))
    tab.step("Review")
    tab.button("Export…").click()
    tab.field("mjcf").check()
    tab.field("Folder").fill("mine")
    tab.button("Export").click()
    page.get_by_text("Written to", exact=False).wait_for()
    out = Path(tab.server.config.workspace) / "exports" / "mine"
    assert [j.type for j in load_object(out / "urdf").tree.joints] == ["revolute"]
    assert list((out / "mjcf").glob("*.xml"))
