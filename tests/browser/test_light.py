"""How the picture looks: plain light without a GPU, display controls, and a page that opens."""

import io
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from PIL import Image

from tests.browser.browsing import COARSE, SHOWN, Tab, wait_until

SURROUNDINGS = "() => window.__viserMutable.scene.environment !== null"
LAMPS = "() => '/light/sky' in window.__viserSceneTree.getState()"


def test_without_a_gpu_it_is_plain_until_taken_back_and_that_is_kept(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / f"{name}.glb")
    tab = open_tab(start(tmp_path / "one.glb", tmp_path / "two.glb"))
    page = tab.page

    def lit(plainly: bool) -> bool:
        return bool(page.evaluate(LAMPS)) == plainly != page.evaluate(SURROUNDINGS)

    wait_until(lambda: lit(True), "lit plainly, as nothing was chosen and a processor draws")
    assert tab.field("Simple lighting").is_checked()
    tab.wait_node("/edges")  # a box has no texture
    wait_until(lambda: tab.app.drawing.detail.lit, "light is in the vertex colors")
    tab.field("Edges").uncheck()
    page.wait_for_function("() => !('/edges' in window.__viserSceneTree.getState())")
    tab.field("Edges").check()
    tab.wait_node("/edges")
    first = tab.object
    tab.key("n")
    wait_until(lambda: tab.object not in (first, None) and tab.app.drawing.drawn, "the next object")
    tab.wait_node("/scan")
    wait_until(lambda: lit(True), "still lit plainly")
    tab.field("Simple lighting").uncheck()
    wait_until(lambda: lit(False), "lit by its surroundings")
    page.reload()
    wait_until(lambda: len(tab.server.apps) == 1 and tab.app.drawing.drawn, "the page again")
    tab.wait_node("/scan")
    wait_until(lambda: lit(False), "lit by its surroundings again")
    tab.field("Simple lighting").check()
    wait_until(lambda: lit(True), "lit plainly again")


GPU = "WebGLRenderingContext.prototype.getParameter = () => 'ANGLE (NVIDIA GeForce RTX 4090)'"


def test_with_a_gpu_it_is_lit_by_its_surroundings(
    start: Any, open_page: Any, tmp_path: Path
) -> None:
    trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / "one.glb")
    server = start(tmp_path / "one.glb")
    page = open_page("about:blank", 800, 600, color_scheme="light")  # a browser of its own
    page.add_init_script(GPU)
    page.goto(f"{server.url}{COARSE}")
    tab = Tab(page, server).ready()
    wait_until(lambda: page.evaluate(SURROUNDINGS), "lit by its surroundings")
    assert not tab.app.light.plain


def test_display_brightens_enlarges_and_colors_points(
    start: Any, open_tab: Any, cabinet: Any, tmp_path: Path
) -> None:
    path, points = cabinet
    cloud = trimesh.load(path).sample(60_000)
    colors = np.broadcast_to((110, 70, 40, 255), (len(cloud), 4))
    trimesh.PointCloud(cloud, colors).export(tmp_path / "scan.ply")
    tab = open_tab(start(tmp_path / "scan.ply"))
    if tab.selection.step == "Prepare":
        tab.step("Annotate")
    tab.prompt(points["door"])
    tab.drawn()
    page = tab.page
    page.mouse.move(5, 5)

    def around(name: str) -> np.ndarray:
        """(3,) mean color of the picture at a part."""
        tab.frames(3)
        x, y = tab.pixel(points[name])
        shot = page.screenshot(clip={"x": x - 6, "y": y - 6, "width": 12, "height": 12})
        return np.asarray(Image.open(io.BytesIO(shot)).convert("RGB"), float).mean((0, 1))

    tab.button("Display").click()
    own = {name: around(name) for name in ("door", "base")}
    chosen = page.get_by_label("Point colors")
    chosen.select_option("Parts")
    wait_until(lambda: np.ptp(around("base")) < 20, "the base is gray")
    assert np.ptp(around("door")) > np.ptp(own["door"]), "the door has its color alone"
    chosen.select_option("Height")
    wait_until(lambda: around("base")[1] > around("base")[2] + 60, "yellow is high", 60)
    chosen.select_option("Normals")
    wait_until(lambda: around("base")[2] > around("base")[1] + 100, "the top is blue", 60)
    assert around("door")[1] > around("door")[2] + 100, "the front is green"
    chosen.select_option("Own")
    wait_until(lambda: np.allclose(around("base"), own["base"], atol=8), "its own again", 60)
    page.get_by_label("Brightness").fill("2")
    wait_until(lambda: around("base").mean() > own["base"].mean() + 10, "brighter", 60)
    page.get_by_label("Point size").fill("3")
    page.reload()
    wait_until(lambda: len(tab.server.apps) == 1 and tab.app.drawing.drawn, "the page again")
    tab.button("Display").click()
    assert page.get_by_label("Brightness").input_value() == "2"
    assert page.get_by_label("Point size").input_value() == "3"


_OPENING = """(() => {
  const seen = (node) => node && getComputedStyle(node).visibility !== "hidden";
  const look = () => {
    const buttons = [...document.querySelectorAll("button")];
    const named = (name) => buttons.find((b) => b.textContent.includes(name));
    const ours = [named("Predict joints"), document.querySelector("[aria-label='Four views']")];
    const early = ours.some(seen) && !window.__artiworld.get().shown;
    if (early || seen(named("Save Canvas"))) window.__early = true;
  };
  new MutationObserver(look).observe(document, { subtree: true, childList: true });
})()"""


def test_a_dark_page_opens_dark_and_shows_no_panel_before_it_is_ours(
    start: Any, open_page: Any, tmp_path: Path
) -> None:
    """viser's own panel, and our buttons before an object is there, said nothing that holds."""
    trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / "one.glb")
    server = start(tmp_path / "one.glb")
    page = open_page("about:blank", 800, 600, color_scheme="dark")
    page.add_init_script(_OPENING)
    page.goto(f"{server.url}{COARSE}", wait_until="commit")
    page.wait_for_function("() => document.body")
    color = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
    assert max(int(v) for v in color[4:-1].split(", ")[:3]) < 80, color
    Tab(page, server).ready()
    page.wait_for_selector(":root.aw-begun", state="attached")
    assert not page.evaluate("() => window.__early")


def test_a_page_with_an_empty_queue_is_shown(start: Any, open_page: Any, tmp_path: Path) -> None:
    (tmp_path / "broken.glb").write_bytes(b"no mesh")
    server = start(tmp_path / "broken.glb")
    page = open_page(f"{server.url}{COARSE}")
    page.get_by_role("button", name="Remove", exact=True).click()
    wait_until(lambda: not server.app_state.queue.records(), "the queue is empty")
    page.goto("about:blank")
    page.goto(f"{server.url}{COARSE}")
    page.wait_for_function(SHOWN)
    page.get_by_text("The queue is empty").wait_for()
