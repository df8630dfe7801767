"""The queue as the page asks for it: pieces, search, order, and what is no number."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from app.server.app_state import AppState
from app.server.config import ServeConfig
from app.server.guard import Route, RouteRequest
from app.server.server import queue_routes
from model.core.geometry import PointCloud
from model.io.write import write_cloud
from sessions import commands as cmd
from sessions.command_log import read_work
from sessions.statistics import acts_of, figures_of
from sessions.store import Store
from sessions.tool_commands import LeaveOut
from tests.builders import wait_until


@pytest.fixture
def app_state(tmp_path: Path) -> Iterator[AppState]:
    names = [f"chair {k:02}.ply" for k in range(30)] + ["oven.ply"]
    for name in names:
        (tmp_path / name).write_bytes(b"not read here")
    paths = [tmp_path / name for name in names]
    state = AppState(ServeConfig(workspace=tmp_path / "w"), Store(tmp_path / "w"), paths)
    yield state
    state.close()


@pytest.fixture
def rows(app_state: AppState) -> Route:
    return queue_routes(app_state.gallery)["/queue.json"]


def asked(rows: Route, **query: str) -> dict:
    return json.loads(rows(RouteRequest("/queue.json", query)).body)


def test_a_piece_of_the_list_says_how_long_it_is(rows: Route) -> None:
    found = asked(rows, first="10", count="5")
    assert [r["name"] for r in found["rows"]] == [f"chair {k}" for k in range(10, 15)]
    assert (found["total"], found["all"], found["states"]) == (31, 31, {"todo": 31})
    assert len(asked(rows, search="oven")["rows"]) == 1
    shown = [r["id"] for r in asked(rows, search="7 CHAIR")["rows"]]
    assert asked(rows, search="7 CHAIR", ids="1")["ids"] == shown and len(shown) == 3
    assert asked(rows, search="table")["total"] == 0
    assert asked(rows, state="accepted")["rows"] == []


@pytest.mark.parametrize("number", ["", "-7", "x", "²", "9" * 5000, "1e3"])
def test_what_is_no_number_is_the_beginning(app_state: AppState, number: str) -> None:
    routes = queue_routes(app_state.gallery)
    found = asked(routes["/queue.json"], first=number, count=number, current=number)
    assert found["total"] == 31 and found["at"] == -1
    thumbnail = routes["/thumbnail"](RouteRequest("/thumbnail", {"id": number}))
    assert (thumbnail.status, thumbnail.body) == (204, b"")


def test_a_category_for_many_is_found_and_sorted_by(app_state: AppState, rows: Route) -> None:
    ids = asked(rows, search="chair 1", ids="1")["ids"]  # also 01 and 21
    said: list[tuple[str, str, str]] = []
    app_state.bulk.set_category(ids, "Chair", "ann", lambda *note: said.append(note))
    wait_until(lambda: said, "the category is set")
    assert said == [("Category Chair", "12 of 12 done", "green")]
    found = asked(rows, sort="category", count="14")["rows"]
    assert [r["category"] for r in found] == ["Chair"] * 12 + [""] * 2
    assert {r["who"] for r in found[:12]} == {"ann"}
    assert asked(rows, sort="recent", count="1")["rows"][0]["category"] == "Chair"
    done = app_state.store.load(ids[0]).present
    assert done.category == "Chair" and app_state.bulk.progress is None
    work = figures_of(acts_of(read_work(app_state.workspace)))
    assert (work.objects, work.commands, work.active) == (12, 12, 0.0), "it took nobody's time"


def test_what_can_not_be_done_is_counted_with_its_reason(app_state: AppState) -> None:
    ids = [r.id for r in app_state.queue.records()][:2]
    said: list[tuple[str, str, str]] = []
    app_state.bulk.export(ids, lambda _: None, lambda *n: said.append(n), lambda: None)  # type: ignore[arg-type, return-value]
    wait_until(lambda: said, "the export ends")
    assert said == [("Export", "0 of 2 done. 2: not accepted: it has no asset yet", "orange")]
    with pytest.raises(cmd.CommandError, match="no objects"):
        app_state.bulk.predict([], "ann", lambda *n: None)


def test_what_is_imported_meanwhile_is_listed(app_state: AppState, rows: Route) -> None:
    uploads = app_state.workspace / "uploads" / "kitchen-1"
    uploads.mkdir(parents=True)
    for name in ("hood.ply", "tap.ply"):
        (uploads / name).write_bytes(b"not read here")
    other = Store(app_state.workspace)
    other.open_object(uploads / "hood.ply", None, "hood")
    other.open_object(uploads.parents[1] / "objects" / "tap.ply", None, "of a scene")
    app_state.sync_remote()
    assert asked(rows)["total"] == 32 and asked(rows, search="hood")["total"] == 1
    app_state.sync_remote()
    other.open_object(uploads / "tap.ply", None, "tap")
    app_state.sync_remote()
    assert asked(rows)["total"] == 33
    other.close()


def test_a_row_says_whom_the_object_is_assigned_to(app_state: AppState, rows: Route) -> None:
    people = app_state.store.people
    account = people.accounts.add("mona", "manager", "three horses eat 42 apples")
    id = asked(rows, search="oven")["rows"][0]["id"]
    people.work.assign([id], [account], "mona")
    (oven,) = asked(rows, search="oven")["rows"]
    assert (oven["assigned"], oven["who"]) == ("mona", "")
    assert {r["assigned"] for r in asked(rows, search="chair")["rows"]} == {""}


def test_a_thumbnail_shows_no_table_that_was_removed(tmp_path: Path) -> None:
    """Of a raw scan it kept the table that its asset hasn't."""
    rng = np.random.default_rng(0)
    table, box = rng.uniform((-2, -2, -0.01), (2, 2, 0), (4000, 3)), rng.uniform(0, 1, (3000, 3))
    colors = np.repeat([(0, 200, 0), (200, 0, 0)], (4000, 3000), axis=0).astype(np.uint8)
    cloud = PointCloud(np.concatenate([table, box]).astype(np.float32), None, colors)
    write_cloud(cloud, tmp_path / "scan.ply")
    store = Store(tmp_path / "w")
    state = AppState(ServeConfig(workspace=tmp_path / "w"), store, [tmp_path / "scan.ply"])
    try:
        ref = store.put_array(np.arange(4000))
        store.append(1, LeaveOut(ref, 4000), "ann", 0)
        state.queue.refresh(1)
        found = wait_until(lambda: state.gallery.thumbnail(1), "a picture")
        r, g, _ = np.moveaxis(np.asarray(Image.open(io.BytesIO(found)).convert("RGB"), int), -1, 0)
        assert (r > g + 60).any() and not (g > r + 60).any()
    finally:
        state.close()
