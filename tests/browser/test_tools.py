"""Preview, lasso, brush, cut, merge and uploads of several files, in a real browser."""

from pathlib import Path
from typing import Any

import numpy as np

from app.server.tasks import asset_of
from sessions.commands import AddPart, NamePart
from tests.browser.browsing import Tab, wait_until
from tests.browser.objects import write_cloud, write_flush

OVEN = Path(__file__).parents[2] / "static_assets" / "examples" / "oven_scan.ply"


def drag(tab: Tab, points: list[tuple[float, float]]) -> None:
    mouse = tab.page.mouse
    mouse.move(*points[0])
    mouse.down()
    for place in points[1:]:
        mouse.move(*place, steps=6)
    mouse.up()


def tool(tab: Tab, key: str, name: str) -> None:
    tab.key(key)
    wait_until(lambda: tab.app.pointing.tool == name, f"the tool {name}")


def prompts_become(tab: Tab, count: int) -> Any:
    wait_until(lambda: len(tab.document.prompts) == count, f"{count} prompts")
    tab.settled()
    return tab.document.prompts[-1]


def test_the_preview_follows_the_pointer_and_changes_nothing(
    start: Any, open_tab: Any, cabinet: Any
) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    wait_until(lambda: not tab.object.busy, "the object is encoded")
    x, y = tab.pixel(points["door"])

    def moved() -> Any:
        # A hand never quite rests; a page that is still loading misses the first moves.
        tab.page.mouse.move(x - 3, y)
        tab.page.mouse.move(x, y)
        tab.page.wait_for_timeout(300)  # no state says that the pointer rests: time does
        return tab.app.tab.client.scene.get_handle_by_name("/hover/gained")

    shown = wait_until(moved, "dots under the pointer").points
    tab.wait_node("/hover/gained")
    assert len(shown) and tab.document.prompts == ()
    # Off by its key: what was shown goes, and nothing comes any more.
    tab.key("v")
    wait_until(lambda: not tab.app.pointing.hover.on, "the preview is off")
    wait_until(
        lambda: tab.app.tab.client.scene.get_handle_by_name("/hover/gained") is None,
        "dots are gone",
    )
    tab.prompt(points["door"])
    assert tab.document.segmentation.counts[1] > 0
    # The sheet of keys comes by its key and goes as its button says.
    tab.page.keyboard.press("?")
    tab.button("Close (Esc)").wait_for()
    tab.page.keyboard.press("Escape")
    tab.button("Close (Esc)").wait_for(state="detached")
    check_a_row_that_is_drawn_anew_while_it_is_pressed_is_still_pressed(tab)


def check_a_row_that_is_drawn_anew_while_it_is_pressed_is_still_pressed(tab: Tab) -> None:
    for part in (3, 4):
        tab.object.do(AddPart(part, f"name {part}"), "tester")
    rows = tab.page.locator(".aw-parts button")
    row = rows.filter(has_text="name 4")
    row.hover()
    before = row.element_handle()
    tab.page.mouse.down()
    tab.object.do(NamePart(4, "other name"), "tester")
    rows.filter(has_text="other name").wait_for()
    assert not before.evaluate("row => row.isConnected")
    tab.page.mouse.up()
    wait_until(lambda: tab.selection.part == 4, "the part that was pressed")


def test_lasso_brush_cut_and_merge(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path))
    camera = np.asarray(tab.app.tab.client.camera.position)
    x, y = tab.pixel(points["drawer"])
    tool(tab, "l", "lasso")
    drag(tab, [(x - 90, y - 90), (x + 90, y - 90), (x + 90, y + 120), (x - 90, y + 120)])
    region = prompts_become(tab, 1)
    assert (region.tool, region.part, region.positive) == ("lasso", 1, True) and region.count
    np.testing.assert_allclose(tab.app.tab.client.camera.position, camera, err_msg="it orbited")
    tool(tab, "i", "brush")
    tab.key("2")
    wait_until(lambda: tab.selection.part == 2, "part 2")
    x, y = tab.pixel(points["door"])
    drag(tab, [(x - 10, y), (x + 25, y)])
    region = prompts_become(tab, 2)
    assert (region.tool, region.part) == ("brush", 2) and region.count
    tab.key("Escape")
    wait_until(lambda: tab.app.pointing.tool == "click", "back to clicks")

    # The other part joins this one in one step, and one undo brings it back.
    tab.key("m")
    wait_until(lambda: tab.app.pointing.armed == "merge", "merge waits for a part")
    before = tab.document.parts
    tab.app.tab.act(lambda: tab.app.pointing.merge(1))
    wait_until(lambda: [p.id for p in tab.document.parts] == [0, 2], "part 1 joined part 2")
    tab.settled()
    assert 1 not in tab.document.segmentation.parts
    tab.button("Undo").click()
    wait_until(lambda: tab.document.parts == before, "one undo")

    # Cut the base in two by clicks; the smaller side is a new part.
    tab.key("k")
    wait_until(lambda: tab.app.pointing.armed == "cut", "cut waits for places")
    tab.click_places(*(points["base"] + (0.0, offset, 0.0) for offset in (0.1, -0.1)))
    wait_until(lambda: tab.document.face_cuts, "the cut goes through the faces of the carcass")
    tab.settled()
    region = tab.document.prompts[-1]
    assert region.tool == "cut" and region.part == 3
    wait_until(lambda: tab.selection.part == 3, "what was cut off is chosen, to be named")
    assert tab.app.pointing.armed == ""


_DRAWN = """() => {
  let drawn = 0;
  window.__viserMutable.nodeRefFromName["/scan"]?.traverse((node) => {
    if (!node.isMesh && !node.isPoints) return;
    const g = node.geometry, p = g.attributes.position, all = g.index ? g.index.count : p.count;
    const count = Math.min(g.drawRange.count, all);
    if (node.isPoints) { drawn += count; return; }
    const at = (k) => node.position.clone().fromBufferAttribute(p, g.index.getX(k));
    for (let k = 0; k < count; k += 3) {
      const a = at(k);
      drawn += at(k + 1).sub(a).cross(at(k + 2).sub(a)).length() / 2;
    }
  });
  return drawn;
}"""
"""Square metres of a mesh, however finely its light is drawn; number of points of a cloud."""


def test_what_is_hidden_is_neither_drawn_nor_clicked(
    start: Any, open_tab: Any, cabinet: Any, tmp_path: Path
) -> None:
    path, points = cabinet
    chest = tmp_path / "chest.ply"
    lid = write_cloud(chest)["lid"]
    tab = open_tab(start(path, chest))

    def drawn(shown: Any, what: str) -> None:
        area = tab.object.asset.area
        much = float(shown.sum() if area is None else area[shown].sum())
        wait_until(lambda: abs(tab.page.evaluate(_DRAWN) - much) < 1e-3 * much, what, 60)

    for name, place in (("cabinet", points["door"]), ("chest", lid)):
        if name != tab.object.record.name:
            tab.key("n")
            wait_until(lambda: tab.object.record.name == "chest", "the cloud")
            wait_until(lambda: tab.app.drawing.drawn, "it is drawn")
        wait_until(lambda: not tab.object.busy, "the object is encoded")
        tab.camera_at_rest()
        tab.prompt(place)
        labels = tab.object.labels
        front = tab.document.prompts[0].element
        drawn(np.ones(len(labels), bool), "all is drawn")
        tab.key("h")
        drawn(labels != 1, "without the part")
        tab.key("2")
        wait_until(lambda: tab.selection.part == 2, "part 2")
        tab.prompt(place)
        behind = tab.document.prompts[1].element
        assert behind != front and labels[behind] != 1
        tab.key("1")
        wait_until(lambda: tab.selection.part == 1, "part 1")
        tab.key("h")
        drawn(np.ones(len(labels), bool), "all again")


def test_one_name_for_all_knobs(start: Any, open_tab: Any) -> None:
    """The bundled oven: one knob, the others by their shape, one name, one undo."""
    tab = open_tab(start(OVEN))
    wait_until(lambda: tab.object.preparing.current, "a proposal")
    tab.drawn()
    assert tab.selection.step == "Annotate", "an upright, clean object is not asked about"
    assert not tab.app.prepare.noticed(tab.object)
    assert not tab.button("Prepare (Enter)").count()
    wait_until(lambda: not tab.object.busy, "the object is encoded")
    tab.prompt((-0.2518, -0.3616, 0.8229))
    check_that_finds_wait_for_a_decision(tab)
    tab.settled()
    knobs = [p.id for p in tab.document.parts if p.id]
    assert not tab.document.part_names
    tab.button("knob").click()
    wait_until(lambda: tab.document.part_names, "a name")
    assert tab.document.part_names == dict.fromkeys(knobs, "knob")
    note = tab.page.locator(".mantine-Notification-root", has_text="more parts named knob")
    note.wait_for()
    check_that_a_note_covers_nothing_and_can_be_read_again(tab, note)
    tab.key("Control+z")
    wait_until(lambda: not tab.document.part_names, "all names are taken back")
    assert [p.id for p in tab.document.parts if p.id] == knobs


def check_that_a_note_covers_nothing_and_can_be_read_again(tab: Tab, note: Any) -> None:
    covers = """(note) => { const b = note.getBoundingClientRect();
        return [...document.querySelectorAll("button, input, select")].some((e) => {
            const o = e.getBoundingClientRect();
            return !note.contains(e) && o.width && o.left < b.right && o.right > b.left &&
                o.top < b.bottom && o.bottom > b.top; }); }"""
    wait_until(lambda: not note.evaluate(covers), "it has slid to its place, off all controls")
    note.get_by_role("button").click()
    note.wait_for(state="detached")
    tab.key("F8")
    tab.page.get_by_text("more parts named knob").wait_for()
    tab.key("Escape")
    tab.page.get_by_text("more parts named knob").wait_for(state="detached")


def check_that_finds_wait_for_a_decision(tab: Tab) -> None:
    """Escape drops what Same shape found, Delete one piece of it, Enter makes parts of the rest."""
    tools, before = tab.app.pointing.tools, tab.document
    for keys in ((), ("ArrowRight", "Delete")):
        tab.key("z")
        count = len(wait_until(lambda: tools.finds, "similar parts are shown"))
        tab.wait_node("/hover/lost")
        tab.page.get_by_text(f"Similar part 1 of {count}").wait_for()
        assert count > 3 and tab.document == before
        camera = tab.camera_at_rest()
        for key in keys:
            tab.key(key)
        if keys:
            wait_until(lambda count=count: len(tools.finds) == count - 1, "one is left out")
            tab.page.get_by_text(f"Similar part 2 of {count - 1}").wait_for()
            np.testing.assert_allclose(tab.camera_at_rest(), camera, err_msg="an arrow turned it")
        tab.key("Enter" if keys else "Escape")
        wait_until(lambda: not tools.finds, "nothing waits any longer")
        assert keys or tab.document == before
    wait_until(lambda: len(tab.document.parts) == 1 + count, "the other knobs are parts")


def test_a_painted_door_is_cut_out_of_two_triangles(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    path = tmp_path / "flush.glb"
    points = write_flush(path)
    tab = open_tab(start(path))
    tab.page.locator('[data-press="label"][value="door"]').click()
    wait_until(lambda: tab.app.pointing.tools.label == "door", "a name for the next part")
    for armed in ("cut", "rectangle"):
        tab.key("k")
        wait_until(lambda armed=armed: tab.app.pointing.armed == armed, armed)
    tab.camera_at_rest()
    drag(tab, [(330, 700), (350, 690)])  # a view of the person's own
    camera = tab.camera_at_rest()
    tab.click_places(points["low"], points["high"])
    wait_until(lambda: tab.document.face_cuts, "faces are split")
    tab.settled()
    asset = wait_until(lambda: tab.object.asset, "it is open with more faces")
    assert asset.element_count > 12
    assert tab.document.part_names == {1: "door"}, "it has the name that was picked"
    mesh = asset_of(asset.folder).mesh
    store = tab.server.app_state.store
    labels = store.get_array(tab.document.segmentation.labels)
    door = mesh.triangles[labels == 1].reshape(-1, 3)
    # As exact as a click on the picture: two pixels.
    np.testing.assert_allclose(door.min(0), points["low"], atol=0.01)
    np.testing.assert_allclose(door.max(0), points["high"], atol=0.01)
    np.testing.assert_allclose(
        tab.app.tab.client.camera.position, camera, err_msg="the view jumped"
    )
    # Clicks go on from there: what is beside the door stays apart from it.
    assert tab.app.pointing.armed == "rectangle"  # for the next one of a row
    tab.key("Escape")
    wait_until(lambda: tab.app.pointing.armed == "", "back to clicks")
    tab.key("2")
    tab.prompt(points["beside"])
    again = store.get_array(tab.document.segmentation.labels)
    np.testing.assert_array_equal(again == 1, labels == 1)
    while tab.document.face_cuts:
        tab.app.commands.undo()
    wait_until(
        lambda: tab.object.asset is not None and tab.object.asset.element_count == 12,
        "undo brings the old faces back",
    )
    assert not tab.document.prompts
    # Three places on a front of two triangles: two of them are on the same one.
    for part, place in enumerate(("low", "high", "beside"), start=1):
        tab.key(str(part))
        tab.prompt(points[place])
    tab.page.get_by_text("Both clicks are on one triangle").first.wait_for()
