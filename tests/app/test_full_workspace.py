"""A workspace that turns full or can't be written, and a saving worker that is killed."""

from __future__ import annotations

import os
import resource
import signal
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.server import tasks
from app.server.display_tasks import open_asset
from app.server.ending import remove_leftovers, unfinished
from app.server.jobs import JobFailed, WorkerProcess
from app.server.part_tasks import PartSource, prepare_asset
from app.server.tasks import ReadOptions
from model.core.errors import InputFileError, StoreError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import publish
from model.io.assets.reader import reload_check
from model.segmentation.prompts import Click
from sessions.commands import AddClick
from sessions.store import Store
from tests.builders import wait_until

DOOR = Joint("door", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0), lower=0, upper=1.5)
TREE = KinematicTree(("link_0", "link_1"), (DOOR,))


@pytest.fixture
def source(tmp_path: Path) -> PartSource:
    trimesh.creation.box((1, 0.5, 0.7)).export(tmp_path / "box.ply")
    workspace = tmp_path / "workspace"
    opened = open_asset(tmp_path / "box.ply", workspace, ReadOptions())
    labels = tasks.arrays_of(workspace).put((np.arange(12) < 2).astype(np.int16))
    return PartSource(opened.folder, workspace, labels, {1: "door"}, "Cabinet", "box")


def fill_disk(size: int) -> None:
    """Let this process write no file beyond so many bytes."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, resource.RLIM_INFINITY))


@pytest.fixture(scope="module")
def worker() -> Iterator[WorkerProcess]:
    """One for all tests: importing what saving needs takes seconds."""
    with WorkerProcess("saving") as made:
        yield made


def test_a_disk_that_is_full_costs_the_draft_and_is_told(
    source: PartSource, worker: WorkerProcess
) -> None:
    for size in (0, 100, 600, 1500):
        worker.submit(fill_disk, size).result(60)
        with pytest.raises(InputFileError, match=r"can't be written.*check space"):
            worker.submit(prepare_asset, source, TREE).result(120)
        assert not list((source.workspace / "drafts").iterdir())
    worker.submit(fill_disk, resource.RLIM_INFINITY).result(60)
    draft = worker.submit(prepare_asset, source, TREE).result(120)
    assert reload_check(publish(draft, source.workspace / "assets" / "a", {}).folder) == []


def test_a_workspace_that_cannot_be_written_is_named(source: PartSource) -> None:
    (source.workspace / "drafts").write_text("in the way")
    with pytest.raises(InputFileError, match=r"drafts.*can't be written"):
        prepare_asset(source, TREE)
    (source.workspace / "drafts").unlink()
    draft = prepare_asset(source, TREE)
    (source.workspace / "assets").write_text("in the way")
    with pytest.raises(InputFileError, match="can't be written"):
        publish(draft, source.workspace / "assets" / "a", {})
    (source.workspace / "assets").unlink()
    assert publish(draft, source.workspace / "assets" / "a", {}).urdf.is_file()


def append_on_a_full_disk(workspace: Path, object_id: int) -> tuple[str, int]:
    """The error of decisions that find no room, and how many were kept after all."""
    store = Store(workspace)
    fill_disk(0)
    error = "none"
    try:
        store.append(object_id, AddClick(Click((0.0, 0.0, 0.0), 1)), "ann", 1)
    except StoreError as raised:
        error = str(raised)
    fill_disk(resource.RLIM_INFINITY)
    kept = len(store.history(object_id))
    store.append(object_id, AddClick(Click((0.0, 0.0, 1.0), 1)), "ann", kept)
    return error, len(store.history(object_id))


def test_a_decision_that_finds_no_room_is_told_and_the_next_is_kept(
    tmp_path: Path, worker: WorkerProcess
) -> None:
    store = Store(tmp_path)
    number = store.open_object(tmp_path / "a.ply", None, "a").id
    store.append(number, AddClick(Click((0.0, 0.0, 0.0), 1)), "ann", 0)
    error, count = worker.submit(append_on_a_full_disk, tmp_path, number).result(60)
    assert "artiworld.db" in error and count == 2
    assert len(store.history(number)) == 2


def test_a_saving_worker_that_is_killed_is_replaced_and_leaves_nothing(
    source: PartSource, worker: WorkerProcess
) -> None:
    job = worker.submit(prepare_asset, source, TREE)
    wait_until(lambda: unfinished(source.workspace))
    assert worker.pid is not None
    os.kill(worker.pid, signal.SIGKILL)
    with pytest.raises(JobFailed, match="SIGKILL"):
        job.result(60)
    draft = worker.submit(prepare_asset, source, TREE).result(120)
    remove_leftovers(source.workspace)
    assert [p.name for p in (source.workspace / "drafts").iterdir()] == [draft.name]
    assert reload_check(publish(draft, source.workspace / "assets" / "a", {}).folder) == []
