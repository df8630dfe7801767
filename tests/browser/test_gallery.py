"""The queue as a gallery of hundreds, work on many of them, and the export, in a real browser."""

from pathlib import Path
from typing import Any

import trimesh

from model.io.assets.asset_folder import write_asset
from model.io.assets.reader import load_object
from sessions import commands as cmd
from tests.browser.browsing import Tab, wait_until
from tests.browser.objects import write_urdf

MANY = 150
CLEARED_WHILE_AN_OBJECT_CHANGES = """(field) => {
    field.value = "";
    field.dispatchEvent(new Event("input"));
    window.__artiworldQueue.changed(null);
}"""


def test_hundreds_are_searched_sorted_changed_and_exported(
    tmp_path: Path, start: Any, open_tab: Any
) -> None:

    box: Any = trimesh.creation.box((0.4, 0.3, 0.2)).export(file_type="ply")
    boxes = [tmp_path / f"box_{k:03}.ply" for k in range(MANY)]
    for path in boxes:
        path.write_bytes(box)
    tab: Tab = open_tab(start(write_urdf(tmp_path), *boxes))
    check_the_gallery(tab)
    check_the_export(tab)


def check_the_gallery(tab: Tab) -> None:
    """Search, select, change many, and open one by keys alone."""
    page, queue = tab.page, tab.server.app_state.queue
    records = {r.name: r.id for r in queue.records()}
    cards = page.locator(".aw-card")
    page.get_by_title("box_003: to do").wait_for()
    assert cards.count() < 40, "only what is seen is there"

    # The gallery: thumbnails come from a worker; search, selection, and an action on all found.
    page.get_by_role("button", name="Gallery or list").click()
    page.wait_for_function("() => document.querySelectorAll('.wide .drawn').length > 0")
    assert list((Path(tab.server.config.workspace) / "thumbnails").glob("*.webp"))
    page.get_by_label("Search", exact=True).fill("box_14")
    wait_until(lambda: cards.count() == 10, "ten are found")
    page.get_by_label("Select box_140").check()
    page.get_by_role("button", name="Select all").click()
    page.get_by_text("10 selected").wait_for()
    page.locator(".aw-bulk input[list]").fill("Box")
    page.get_by_role("button", name="Set the category of the selected objects").click()
    wait_until(lambda: sum(r.category == "Box" for r in queue.records()) == 10, "all have it")
    page.get_by_label("Search", exact=True).evaluate(CLEARED_WHILE_AN_OBJECT_CHANGES)
    page.get_by_title("box_003: to do").wait_for()
    page.get_by_label("Sort by").select_option("category")
    page.get_by_title("box_149: in progress").wait_for()

    # Objects without parts are skipped with the reason; by the keyboard alone one is opened.
    page.get_by_role("button", name="Predict", exact=True).click()
    page.get_by_text("10: no parts yet", exact=False).wait_for()
    card = page.locator(".aw-open", has_text="box_145")
    page.get_by_label("Select box_144").focus()
    page.keyboard.press("Tab")
    assert card.evaluate("(e) => getComputedStyle(e).outlineStyle") == "solid", "focus shows"
    page.keyboard.press("Enter")
    wait_until(lambda: tab.object.record.id == records["box_145"], "Enter opens it")
    page.locator(".wide").wait_for(state="detached")


def check_the_export(tab: Tab) -> None:
    """An accepted object is exported to a folder that other software can read."""
    page = tab.page
    records = {r.name: r.id for r in tab.server.app_state.queue.records()}
    path = next(r.path for r in tab.server.app_state.queue.records() if r.name == "cupboard")
    session = tab.server.app_state.hub.session(records["cupboard"])
    tab.app.tab.act(lambda: tab.app.queue.open(records["cupboard"]))
    wait_until(lambda: session.document.tree is not None, "the joints of the file")
    saved = write_asset(load_object(path), path.with_name("asset"), provenance={})
    session.do(cmd.Accept("", (), ""), "tester")
    session.do(cmd.Saved(str(saved.folder)), "tester")
    page.get_by_role("button", name="Gallery or list").click()
    page.get_by_role("button", name="Clear", exact=True).click()  # ten were selected before
    page.get_by_role("button", name="Export the selected objects, or all accepted").click()
    page.get_by_text("Export 1 object").wait_for()  # of all, the accepted one
    tab.field("Read back and compare").uncheck()
    tab.field("Server folder (empty: download)").fill("mine")
    tab.button("Export").click()
    page.get_by_text("Written to", exact=False).wait_for()
    out = Path(tab.server.config.workspace) / "exports" / "mine"
    assert [j.type for j in load_object(out).tree.joints] == ["revolute"]
