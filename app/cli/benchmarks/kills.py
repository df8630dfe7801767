"""Servers that are killed at random moments while objects are uploaded, named and accepted.

A server without browsers says on its output what is decided; after its end nothing of that may be
lost in the workspace, and the next server leaves nothing half-written over.
"""

from __future__ import annotations

import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from app.server.accepting import accept
from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.leftovers import unfinished
from model.core.errors import ArtiworldError
from model.core.progress import Progress
from model.io.assets.reader import load_object
from sessions.commands import NamePart
from sessions.store import Store

MOST_DECISIONS = 9
"""Before a kill; three are an object."""
LONGEST = 1.0
"""Seconds from a decision to a kill; the next one is there before."""
START_SECONDS = 120.0
_CABINET = """<mujoco model="cabinet"><worldbody><body name="case">
<geom type="box" size="0.3 0.2 {height}" pos="0 0 0.5"/><body name="door" pos="-0.3 -0.22 0.5">
<joint name="hinge" axis="0 0 -1" range="0 90"/><geom type="box" size="0.3 0.01 0.3" pos="0.3 0 0"/>
</body></body></worldbody></mujoco>"""
_CODE = "import sys; from app.cli.benchmarks.kills import work; work(*sys.argv[1:])"


def kill_servers(kills: int, seed: int, progress: Progress) -> dict[str, Any]:
    """Kill so many servers of one workspace.

    Returns:
        Counts of what was decided, and what of it is lost or left over, in words.
    """
    decided: list[list[str]] = []
    lost: list[str] = []
    left: set[str] = set()
    with tempfile.TemporaryDirectory(prefix="artiworld-kills-") as folder:
        workspace = Path(folder, "workspace")
        for number in range(kills):
            progress(number / kills, f"server {number + 1} of {kills}")
            decided += _killed(workspace, f"{seed}-{number}", random.Random(f"{seed}-{number}"))
            lost = _lost(workspace, decided)
            left |= {str(p.relative_to(workspace)) for p in unfinished(workspace)}
    count = {kind: sum(d[0] == kind for d in decided) for kind in ("uploaded", "named", "accepted")}
    return {"kills": kills, **count, "lost": "; ".join(lost), "left over": "; ".join(sorted(left))}


def _killed(workspace: Path, name: str, rng: random.Random) -> list[list[str]]:
    """Run a server until a random moment; what it decided, each as words."""
    process = subprocess.Popen(
        [sys.executable, "-c", _CODE, str(workspace), name],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert process.stdout is not None
    said = [process.stdout.readline() for _ in range(rng.randint(1, MOST_DECISIONS))]
    with suppress(subprocess.TimeoutExpired):
        process.wait(rng.uniform(0.0, LONGEST))
    process.kill()
    said += process.stdout.read().splitlines(keepends=True)
    process.wait()
    return [line.split(" ", 2) for line in said[1:] if line.endswith("\n")]  # 0: it is ready


def _lost(workspace: Path, decided: list[list[str]]) -> list[str]:
    """Decisions that are missing in the workspace's next server."""
    state = AppState(ServeConfig(workspace=workspace), Store(workspace), [])
    try:
        queued = {record.id for record in state.queue.records()}
        return [" ".join(d).strip() for d in decided if not _is_there(state, queued, *d)]
    finally:
        state.close()
        state.store.close()


def _is_there(state: AppState, queued: set[int], kind: str, number: str, name: str = "") -> bool:
    document = state.store.load(int(number)).present
    if kind == "named":
        return document.part_names.get(1) == name.strip()
    if kind == "accepted":
        if document.review.state != "accepted" or document.saved is None:
            return False
        try:
            return len(load_object(document.saved.folder).parts) == 2
        except ArtiworldError:
            return False
    return int(number) in queued


def work(workspace: str, name: str) -> None:
    """Be a server to be killed: upload, name and accept objects, and say what is done."""
    config = ServeConfig(workspace=Path(workspace))
    state = AppState(config, Store(config.workspace), [])
    rng = random.Random(name)
    print("ready", flush=True)
    for number in range(1000):
        content = _CABINET.format(height=rng.uniform(0.3, 0.5)).encode()
        object_id = state.add_upload(f"cabinet-{name}-{number}.xml", content)
        print("uploaded", object_id, flush=True)
        obj = state.object(object_id)
        _wait_for(lambda obj=obj: obj.document.segmentation_current and obj.document.tree)
        obj.do(NamePart(1, f"door {name} {number}"), "ann")
        print("named", object_id, f"door {name} {number}", flush=True)
        report = _wait_for(lambda obj=obj: obj.validation.report)
        accept(obj, "", "ann", "as it is", seen=report)
        _wait_for(lambda obj=obj: obj.document.saved)
        print("accepted", object_id, flush=True)


def _wait_for(condition: Callable[[], Any]) -> Any:
    end = time.monotonic() + START_SECONDS
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError("the server doesn't go on")
        time.sleep(0.01)
    return value
