"""Small windows and tablets: nothing lies on another control, and fingers hit what they mean."""

from typing import Any

from app.server.page import show_markup
from tests.browser.browsing import Tab, wait_until

LAID_OUT = """() => {
  const box = (e) => {
    const b = e.getBoundingClientRect();
    return [b.left, b.top, b.right, b.bottom];
  };
  const at = (name) => document.querySelector(name);
  const controls = ["#artiworld-steps", "#artiworld-tools", "#artiworld-view"];
  return { picture: box(window.__viserMutable.canvas),
    controls: Object.fromEntries(controls.map((name) => [name, box(at(name))])) };
}"""
SMALL = """() => [...document.querySelectorAll("button, select, input:not([type=hidden])")]
  .filter((e) => e.checkVisibility({ visibilityProperty: true }))
  .map((e) => [e.getAttribute("aria-label") || e.textContent || e.type, e.getBoundingClientRect()])
  .filter(([, b]) => b.width && (Math.round(b.width) < 40 || Math.round(b.height) < 40))
  .map(([name, b]) => `${name}: ${b.width.toFixed()} x ${b.height.toFixed()}`)"""


def apart(tab: Tab) -> bool:
    """Whether steps, rail and corner lie in the picture and not on each other."""
    found = tab.page.evaluate(LAID_OUT)
    left, top, right, bottom = found["picture"]
    boxes = list(found["controls"].values())
    inside = all(
        b[0] >= left and b[1] >= top and b[2] <= right and b[3] <= bottom and b[2] > b[0]
        for b in boxes
    )
    return inside and not any(
        a[0] < b[2] and b[0] < a[2] and a[1] < b[3] and b[1] < a[3]
        for i, a in enumerate(boxes)
        for b in boxes[:i]
    )


def test_controls_keep_apart_and_the_rail_folds(start: Any, open_tab: Any, cabinet: Any) -> None:
    tab = open_tab(start(cabinet[0]), 1100, 700)

    def share() -> float:
        left, _, right, _ = tab.page.evaluate(LAID_OUT)["picture"]
        return float(right - left) / 1100

    wait_until(lambda: share() >= 0.6, "the picture has most of the window: the queue folds")
    for step in ("Prepare", "Annotate"):
        tab.step(step)
        wait_until(lambda: apart(tab), f"nothing overlaps in {step}: {tab.page.evaluate(LAID_OUT)}")
    rail = tab.page.locator("#artiworld-tools")
    whole = rail.bounding_box()
    assert whole["width"] <= 40, "a slim column"
    tab.page.get_by_role("button", name="Fold the tools").click()
    wait_until(lambda: rail.bounding_box()["height"] < whole["height"] / 2, "it is folded")
    tab.key("m")
    tab.page.locator('[data-press="tool"][value="Merge"]').wait_for()  # what is used is seen
    tab.page.reload()
    tab.page.get_by_role("button", name="Show all tools").click()
    tab.page.locator('[data-press="tool"][value="Lasso"]').wait_for()
    progress_beside_dialogs(tab)


def progress_beside_dialogs(tab: Tab) -> None:
    """An export that runs is seen, and covers nothing of the dialog."""
    client = tab.app.tab.client
    asked = "JSON.stringify({ action: 'export', value: '', ids: [id] })"
    tab.page.evaluate(f"id => window.__artiworldMarkup.send('bulk', {asked})", tab.object.record.id)
    dialog = tab.page.locator(".mantine-Modal-content")
    dialog.wait_for()
    show_markup(client, "progress", "<span>Exporting</span>")
    bar = tab.page.locator("#artiworld-progress")
    bar.wait_for()

    def beside() -> bool:
        box, low = dialog.bounding_box(), bar.bounding_box()
        return bool(box["y"] + box["height"] <= low["y"] and low["y"] + low["height"] <= 700)

    wait_until(beside, "the progress is below the dialog", 60)


def test_fingers_find_their_targets_on_tablets(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path), 820, 1180, has_touch=True)
    for width, height in ((820, 1180), (1180, 820)):
        tab.page.set_viewport_size({"width": width, "height": height})
        wait_until(lambda: apart(tab), f"nothing overlaps at {width} x {height}")
        wait_until(lambda: not tab.page.evaluate(SMALL), "targets of 40 pixels", 60)
    tab.app.rail.touch = True
    tab.app.tab.invalidate()
    tab.wait_node("/touch")
    tab.drawn()
    tab.camera_at_rest()
    tab.page.touchscreen.tap(*tab.pixel(points["door"]))
    wait_until(lambda: len(tab.document.prompts) == 1, "a tap is a prompt")
    tab.settled()
    labels = tab.object.services.store.get_array(tab.document.segmentation.labels)
    assert labels[tab.document.prompts[0].element] == 1
