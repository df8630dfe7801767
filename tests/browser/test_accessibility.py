"""axe's automatic checks of the views, light and dark: names, roles, contrast."""

from pathlib import Path
from typing import Any

import pytest

from sessions import commands as cmd
from sessions.store import Store
from tests.browser.browsing import SceneTab, log_in, wait_until
from tests.browser.test_project import PASSWORD, open_project
from tests.browser.test_scene import entry
from tests.model.scenes.scenes_made import make_assets, own, write_scene

NAMED = """() => [...document.querySelectorAll(
  ".mantine-Flex-root :is(input, textarea), .mantine-Notification-closeButton")].every(
  (e) => e.labels?.length || e.getAttribute("aria-label"))"""
"""The page names new fields twice a second."""
RULES = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}}


def problems(page: Any) -> list[str]:
    """What axe finds on the page, one line each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    page.wait_for_function(NAMED)
    found = axe.Axe().run(page, options=RULES).response["violations"]
    return [
        f"{rule['id']}: {node['html'][:160]} {node['failureSummary'].splitlines()[-1].strip()}"
        for rule in found
        for node in rule["nodes"]
    ]


def test_the_main_views_pass_in_both_themes(start: Any, open_tab: Any, cabinet: Any) -> None:
    path, points = cabinet
    tab = open_tab(start(path), color_scheme="light")
    page = tab.page
    tab.prompt(points["door"])
    tab.object.do(cmd.NamePart(1, "door"), "tester")
    tab.object.do(cmd.SetCategory("StorageFurniture"), "tester")
    tab.drawn()
    for theme in ("light", "dark"):
        page.emulate_media(color_scheme=theme)
        page.wait_for_selector(f':root[data-mantine-color-scheme="{theme}"]', state="attached")
        assert not problems(page), f"annotate, {theme}"
        if tab.document.tree is None:
            tab.key("p")
            wait_until(lambda: tab.document.tree is not None, "joints")
        for step in ("Prepare", "Joints", "Review"):
            tab.step(step)
            assert not problems(page), f"{step}, {theme}"
        tab.step("Annotate")
    page.keyboard.press("?")
    page.get_by_role("dialog").wait_for()
    assert not problems(page), "the sheet of keys"
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    page.get_by_role("button", name="Gallery or list").click()
    page.locator(".aw-queue.wide").wait_for()
    assert not problems(page), "the gallery"
    page.keyboard.press("Escape")
    open_project(tab)
    assert not problems(page), "the project page"


def test_a_scene_passes_in_both_themes(start: Any, open_tab: Any, tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "home.json", own([entry("cabinet 1", "cab", 0.0)]))
    server = start(scene=scene, assets=(make_assets(tmp_path / "assets"),), predictor="geometric")
    tab = open_tab(server, kind=SceneTab, color_scheme="light")
    wait_until(lambda: tab.status("cabinet 1") == "predicted", "the cabinet is predicted")
    tab.scene.choice.choose("cabinet 1")
    for theme in ("light", "dark"):
        tab.page.emulate_media(color_scheme=theme)
        chosen = f':root[data-mantine-color-scheme="{theme}"]'
        tab.page.wait_for_selector(chosen, state="attached")
        assert not problems(tab.page), theme


def test_login_and_account_pass_in_both_themes(start: Any, open_page: Any, tmp_path: Path) -> None:
    store = Store(tmp_path / "workspace")
    store.people.accounts.add("ann", "annotator", PASSWORD)
    store.close()
    server = start()
    page = open_page(server.url, color_scheme="light")
    page.wait_for_url("**/login")
    for theme in ("light", "dark", "light"):
        page.emulate_media(color_scheme=theme)
        back = page.evaluate("() => getComputedStyle(document.body).backgroundColor")
        assert (max(int(v) for v in back[4:-1].split(", ")[:3]) < 80) == (theme == "dark")
        assert not problems(page), f"{page.url}, {theme}"
        if theme == "dark":
            log_in(page, server, "ann", PASSWORD)
            page.goto(f"{server.url}/login")
            page.get_by_label("New password").wait_for()
