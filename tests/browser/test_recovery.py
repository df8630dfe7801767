"""SIGKILL in the middle of the work: what was clicked is there when the page opens again."""

import os
import re
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

from sessions.store import PendingAcceptance, Store
from tests.browser.browsing import COARSE, page_at_rest
from tests.browser.objects import write_cabinet
from tests.builders import wait_until


def serve(path: Path, workspace: Path) -> tuple[subprocess.Popen[str], str]:
    """The real program; its address as it prints it."""
    process = subprocess.Popen(
        [sys.executable, "-m", "app", "serve", str(path), "--workspace", str(workspace)]
        + ["--port", "0", "--no-open", "--user", "tester"],
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        cwd=Path(__file__).parents[2],
    )
    assert process.stdout is not None
    seen = []
    for line in process.stdout:
        seen.append(line)
        found = re.search(r"http://\S+", line)
        if found and "ready" in line:
            return process, found.group(0)
    raise AssertionError("the server didn't start:\n" + "".join(seen))


def opened(page: Any) -> Any:
    """The page once its picture is there."""
    page.wait_for_function(
        "() => { const s = window.__viserSceneTree?.getState?.(); return !!s && !!s['/scan']; }"
    )
    page.wait_for_function("() => window.__artiworld.get().drawing")  # it comes after the camera
    page_at_rest(page)
    return page


def labelled(workspace: Path) -> bool:
    """Whether the labels of the last click are stored."""
    store = Store(workspace)
    try:
        return store.load(store.objects()[0].id).present.segmentation_current
    finally:
        store.close()


def test_nothing_is_lost_when_the_server_is_killed(tmp_path: Path, open_page: Any) -> None:
    path, workspace = tmp_path / "cabinet.ply", tmp_path / "workspace"
    write_cabinet(path)
    process, url = serve(path, workspace)
    try:
        page = opened(open_page(f"{url}{COARSE}"))
        middle = page.evaluate(
            "() => { const b = window.__viserMutable.canvas.getBoundingClientRect();"
            " return [b.left + b.width / 2, b.top + b.height / 2]; }"
        )
        page.mouse.click(middle[0] - 60, middle[1] + 30)
        page.get_by_text("1 on this part, 1 in total", exact=False).wait_for()
        page.keyboard.press("2")
        page.locator('[data-press=part][value="2"][aria-pressed=true]').wait_for()
        page.mouse.click(middle[0] + 80, middle[1] + 30)
        page.get_by_text("1 on this part, 2 in total", exact=False).wait_for()
        # Else the next server stores them, and an object that changed isn't being accepted.
        wait_until(lambda: labelled(workspace), "the labels are stored")
    finally:
        os.kill(process.pid, signal.SIGKILL)
        process.wait()
    page.get_by_text("The server is away", exact=False).wait_for()
    page.close()

    before = Store(workspace)
    (record,) = before.objects()
    kept = before.load(record.id).present
    # As a server leaves it that dies while it saves an asset.
    before.begin_acceptance(record.id, PendingAcceptance(record.seq, "the hinge is bent"))
    before.close()
    assert len(kept.prompts) == 2

    process, url = serve(path, workspace)
    try:
        page = opened(open_page(f"{url}{COARSE}"))
        page.get_by_text("2 in total", exact=False).wait_for()
        page.wait_for_function("() => !!window.__viserSceneTree.getState()['/prompt/1']")
        page.get_by_role("button", name="Review").first.click()
        page.wait_for_function(
            "() => [...document.querySelectorAll('textarea')]"
            ".some(e => e.value === 'the hinge is bent')"
        )
        page.close()
        after = Store(workspace)
        assert after.load(after.objects()[0].id).present.prompts == kept.prompts
        after.close()
    finally:
        process.send_signal(signal.SIGTERM)
        process.wait(120)
    assert process.returncode == 0
