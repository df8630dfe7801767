"""A real Chromium and a real server for the browser tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.browser.browsing import CHROMIUM_FLAGS, COARSE, Tab, find_chromium


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    path = find_chromium()
    if path is None:
        pytest.skip("Chromium is not installed: apt-get install chromium")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path, args=list(CHROMIUM_FLAGS))
        yield chromium
        chromium.close()


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Callable[..., Any]]:
    """Start servers in this process: ``start(paths, **ServeConfig fields)``."""
    from app.cli.serve import start_server
    from app.server.config import ServeConfig

    running: list[Any] = []

    def begin(*paths: Path, **settings: Any) -> Any:
        config = ServeConfig(
            paths=tuple(paths),
            workspace=settings.pop("workspace", tmp_path / "workspace"),
            port=0,
            user=settings.pop("user", "tester"),
            **settings,
        )
        running.append(start_server(config))
        return running[-1]

    yield begin
    for server in running:
        server.close()


@pytest.fixture
def open_tab(browser: Any) -> Iterator[Callable[..., Tab]]:
    """Open the page of a server: ``open_tab(server)``; several tabs are several browsers."""
    contexts: list[Any] = []

    def begin(
        server: Any, width: int = 1280, height: int = 800, kind: type[Tab] = Tab, **context: Any
    ) -> Tab:
        contexts.append(browser.new_context(viewport={"width": width, "height": height}, **context))
        page = contexts[-1].new_page()
        page.goto(f"{server.url}{COARSE}")
        return kind(page, server).ready()

    yield begin
    for context in contexts:
        context.close()
