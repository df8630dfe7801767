"""axe's automatic checks of the main views, light and dark: names, roles, contrast."""

from typing import Any

import pytest

from sessions import commands as cmd
from tests.browser.browsing import Tab, wait_until

NAMED = """() => [...document.querySelectorAll(
  ".mantine-Flex-root :is(input, textarea), .mantine-Notification-closeButton")].every(
  (e) => e.labels?.length || e.getAttribute("aria-label"))"""
"""The page names new fields twice a second."""
RULES = {"runOnly": {"type": "tag", "values": ["wcag2a", "wcag2aa", "wcag21a", "wcag21aa"]}}


def problems(tab: Tab) -> list[str]:
    """What axe finds on the page, one line each."""
    axe = pytest.importorskip("axe_playwright_python.sync_playwright")
    tab.page.wait_for_function(NAMED)
    found = axe.Axe().run(tab.page, options=RULES).response["violations"]
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
        assert not problems(tab), f"annotate, {theme}"
        if tab.document.tree is None:
            tab.key("p")
            wait_until(lambda: tab.document.tree is not None, "joints")
        for step in ("Joints", "Review"):
            tab.step(step)
            assert not problems(tab), f"{step}, {theme}"
        tab.step("Annotate")
    page.keyboard.press("?")
    page.get_by_role("dialog").wait_for()
    assert not problems(tab), "the sheet of keys"
    page.keyboard.press("Escape")
    page.get_by_role("dialog").wait_for(state="detached")
    page.get_by_role("button", name="Gallery or list").click()
    page.locator(".aw-queue.wide").wait_for()
    assert not problems(tab), "the gallery"
