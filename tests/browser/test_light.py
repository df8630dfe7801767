"""Plain light for browsers without a GPU: seen in the page, kept over objects and reloads."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import trimesh
from browsing import wait_until

pytestmark = [pytest.mark.browser, pytest.mark.flaky(reruns=2, reruns_delay=2)]

SURROUNDINGS = "() => window.__viserMutable.scene.environment !== null"
LAMPS = "() => '/light/sky' in window.__viserSceneTree.getState()"


def test_plain_light_is_chosen_kept_and_taken_back(
    start: Any, open_tab: Any, tmp_path: Path
) -> None:
    for name in ("one", "two"):
        trimesh.creation.box((0.4, 0.3, 0.2)).export(tmp_path / f"{name}.glb")
    tab = open_tab(start(tmp_path / "one.glb", tmp_path / "two.glb"))
    page = tab.page

    def lit(plainly: bool) -> bool:
        return bool(page.evaluate(LAMPS)) == plainly != page.evaluate(SURROUNDINGS)

    wait_until(lambda: lit(False), "lit by its surroundings")
    tab.field("Plain light").check()
    wait_until(lambda: lit(True), "lit plainly")
    first = tab.app.object
    tab.key("n")
    wait_until(lambda: tab.app.object not in (first, None) and tab.app.drawn, "the next object")
    tab.wait_node("/scan")
    assert lit(True)
    page.reload()
    wait_until(lambda: len(tab.server.apps) == 1 and tab.app.drawn, "the page again")
    wait_until(lambda: lit(True), "lit plainly again")
    tab.field("Plain light").uncheck()
    wait_until(lambda: lit(False), "lit by its surroundings again")
