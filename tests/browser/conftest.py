"""A real Chromium and a real server for the browser tests."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.browser.browsing import (
    CHROMIUM_FLAGS,
    COARSE,
    FEWER_FRAMES,
    PAGE_TIMEOUT,
    Tab,
    find_chromium,
)
from tests.browser.objects import write_cabinet


@pytest.fixture(scope="session", autouse=True)
def _shared_workers(workers_of_all_servers: None) -> None: ...


@pytest.fixture(scope="session")
def cabinet(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, np.ndarray]]:
    """A cabinet's file and a visible point of each part, see :func:`write_cabinet`."""
    path = tmp_path_factory.mktemp("cabinet") / "cabinet.ply"
    return path, write_cabinet(path)


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
def start(tmp_path: Path, cabinet: tuple[Path, Any]) -> Iterator[Callable[..., Any]]:
    """Start servers in this process: ``start(paths, **ServeConfig fields)``.

    Those of the cabinet share a workspace, where it is encoded once, but no database.
    """
    from app.cli.serve import start_server
    from app.server.config import ServeConfig

    running: list[Any] = []

    def begin(*paths: Path, **settings: Any) -> Any:
        own: dict[str, Any] = {"workspace": tmp_path / "workspace", "port": 0, "user": "tester"}
        if paths[:1] == cabinet[:1]:
            own["workspace"] = cabinet[0].with_name("workspace")
            own["database"] = f"sqlite:///{tmp_path / 'artiworld.db'}"
        config = ServeConfig(paths=tuple(paths), **{**own, **settings})
        running.append(start_server(config))
        return running[-1]

    yield begin
    for server in running:
        server.close()


@pytest.fixture(scope="session")
def kept() -> dict[str, Any]:
    """The page that goes from test to test, where one is open."""
    return {}


@pytest.fixture
def open_page(browser: Any, kept: dict[str, Any]) -> Iterator[Callable[..., Any]]:
    """Open an address: ``open_page(url)``; several pages of a test are several browsers.

    A test's first page without settings goes on to the next test, with nothing remembered: opening
    another address there takes less than another browser.
    """
    opened: list[tuple[Any, bool]] = []

    def new(viewport: Any, settings: dict[str, Any]) -> Any:
        context = browser.new_context(viewport=viewport, **settings)
        context.set_default_timeout(PAGE_TIMEOUT)
        context.add_init_script(FEWER_FRAMES)
        return context.new_page()

    def begin(url: str, width: int = 1280, height: int = 800, **settings: Any) -> Any:
        viewport: Any = {"width": width, "height": height}
        keep = not settings and not opened
        if not keep:
            page = new(viewport, settings)
        else:
            page = kept.pop("page", None)
            if page is None or page.is_closed():
                page = new(viewport, {})
            page.set_viewport_size(viewport)
        opened.append((page, keep))
        page.goto(url)
        return page

    yield begin
    for page, keep in opened:
        if keep and not page.is_closed():
            page.evaluate("() => { try { localStorage.clear(); } catch { /* no page came */ } }")
            page.goto("about:blank")
            page.emulate_media(color_scheme="light")  # as a new one has it
            page.context.clear_cookies()
            kept["page"] = page
        else:
            page.context.close()


@pytest.fixture
def open_tab(open_page: Callable[..., Any]) -> Callable[..., Tab]:
    """Open the page of a server: ``open_tab(server)``; several tabs are several browsers."""

    def begin(server: Any, *size: int, kind: type[Tab] = Tab, **settings: Any) -> Tab:
        return kind(open_page(f"{server.url}{COARSE}", *size, **settings), server).ready()

    return begin
