"""Several people at one server: long work of one gives way to the clicks of the others."""

from __future__ import annotations

import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh

from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.segmenting import Segmenting
from app.server.tasks import arrays_of
from app.server.tool_tasks import PROPOSE, ToolRequest
from model.core.files import static_assets
from model.core.memory import LruCache
from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.document import SOURCE_FRAME
from sessions.store import Store
from tests.app.test_open_objects import settled
from tests.builders import cabinet_cloud, wait_until


@pytest.fixture
def app_state(tmp_path: Path):
    scan = cabinet_cloud(12_000).asset.cloud
    assert scan is not None
    trimesh.PointCloud(scan.points, scan.colors).export(tmp_path / "cabinet.ply")
    paths = [tmp_path / "cabinet.ply", static_assets() / "examples" / "kettle.glb"]
    app_state = AppState(ServeConfig(workspace=tmp_path), Store(tmp_path), paths)
    yield app_state
    app_state.close()


def test_clicks_of_others_and_of_other_tabs_come_between_the_steps_of_all_parts(app_state) -> None:
    cabinet, kettle = (settled(app_state, r.id) for r in app_state.queue.records())
    request = ToolRequest(PROPOSE, 1)

    def proposed() -> list[np.ndarray]:
        arrays = arrays_of(app_state.workspace)
        return [np.asarray(arrays.get(p.elements)) for p in cabinet.document.prompts]

    cabinet.segmenting.use_tool(request, "alice")
    alone = proposed()
    cabinet.do(cmd.Undo(), "alice")
    settled(app_state, cabinet.record.id)

    found: list[int] = []
    thread = threading.Thread(
        target=lambda: found.append(cabinet.segmenting.use_tool(request, "alice"))
    )
    thread.start()
    wait_until(lambda: cabinet.jobs.busy.get("tool", (0.0,))[0] > 0, "all parts is under way")
    x, y, _ = kettle.asset.bounds.mean(0)
    start = time.monotonic()
    kettle.do(cmd.AddClick(Click((x, y, float(kettle.asset.bounds[1, 2])), 1)), "bob")
    wait_until(lambda: kettle.document.segmentation_current, "the kettle's parts")
    waited = time.monotonic() - start
    assert thread.is_alive(), f"the click waited for all parts, {waited:.1f} s"
    thread.join(60)
    again = proposed()
    assert found and len(again) == len(alone)
    assert all(np.array_equal(a, b) for a, b in zip(alone, again, strict=True))


def test_what_comes_between_the_steps_of_what_is_made_is_counted_as_well() -> None:
    kept: LruCache[str, str] = LruCache(9, 10)
    made: list[str] = []

    def make(name: str, size: float) -> str:
        made.append(name)
        if name == "outer":
            kept.get("inner", lambda: make("inner", 6), 0, lambda _: 6)
        return name

    kept.get("outer", lambda: make("outer", 6), 6)
    kept.get("outer", lambda: make("outer", 6), 6)
    assert made == ["outer", "inner"]
    kept.get("inner", lambda: make("inner", 6), 6)  # there was no room for both
    assert made == ["outer", "inner", "inner"]


def test_all_parts_is_asked_for_below_everything_and_encodes_first() -> None:
    asked: list[tuple[str, dict]] = []

    def submit(function, *args, **how):
        asked.append((function.__name__, how))
        return SimpleNamespace(result=lambda seconds: [], add_done_callback=lambda _: None)

    jobs = SimpleNamespace(progress=lambda what: None, add=lambda *a: None)
    empty = {**dict.fromkeys(("tree", "up_axis", "left_out", "category")), "unit_scale": 1.0}
    empty |= dict.fromkeys(("prompts", "parts", "face_cuts"), ())
    obj = SimpleNamespace(
        need_asset=lambda: SimpleNamespace(folder="folder"),
        document=SimpleNamespace(**empty, frame=SOURCE_FRAME),
        lane=SimpleNamespace(segmentation=SimpleNamespace(submit=submit)),
        services=SimpleNamespace(workspace=None, config=SimpleNamespace(segmenter="default")),
        jobs=jobs,
        changed=lambda: None,
    )
    Segmenting(obj).use_tool(ToolRequest(PROPOSE, 1), "alice")
    (first, encoding), (second, tool) = asked
    assert (first, second) == ("encode", "use_tool")
    assert encoding["works_on"] == "folder" and tool["works_on"] is None
    assert tool["priority"] < tool["preempted_by"] < 0
