"""Assets are written before they are accepted; a kill at any moment loses none."""

from __future__ import annotations

import multiprocessing
import os
import signal
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from app.server import part_tasks, tasks
from app.server.display_tasks import open_asset
from app.server.part_tasks import DRAFTS_KEPT, PartSource, prepare_asset
from app.server.tasks import ReadOptions
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.assets.asset_folder import publish
from model.io.assets.reader import load_object, read_provenance, reload_check

DOOR = Joint("door", "revolute", "link_0", "link_1", (0, 0, 1), (0, 0, 0), lower=0, upper=1.5)
TREE = KinematicTree(("link_0", "link_1"), (DOOR,))


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> PartSource:
    folder = tmp_path_factory.mktemp("box")
    trimesh.creation.box((1, 0.5, 0.7)).export(folder / "box.ply")
    workspace = folder / "workspace"
    opened = open_asset(folder / "box.ply", workspace, ReadOptions())
    labels = tasks.arrays_of(workspace).put((np.arange(12) < 2).astype(np.int16))
    return PartSource(opened.folder, workspace, labels, {1: "door"}, "Cabinet", "box")


@pytest.fixture(autouse=True)
def no_drafts(source: PartSource) -> None:
    part_tasks.shutil.rmtree(source.workspace / "drafts", ignore_errors=True)


def accepted(source: PartSource, tree: KinematicTree, folder: Path, record: dict) -> Path:
    return publish(prepare_asset(source, tree), folder, record).folder


def drafts(source: PartSource) -> list[str]:
    folder = source.workspace / "drafts"
    return sorted(p.name for p in folder.iterdir()) if folder.is_dir() else []


def test_accepting_moves_what_was_prepared(source, tmp_path, monkeypatch):
    draft = prepare_asset(source, TREE)
    assert prepare_asset(source, TREE) == draft
    with monkeypatch.context() as patch:  # nothing is cut or written a second time
        patch.setattr(part_tasks, "parts_of", None)
        folder = accepted(source, TREE, tmp_path / "a", {"by": "me"})
    assert drafts(source) == []
    record = read_provenance(folder)
    assert record["by"] == "me" and record["asset"]["name"] == "box"
    assert reload_check(folder) == []
    # Accepted again after an edit and without a draft, over the first.
    wider = KinematicTree(TREE.links, (replace(DOOR, upper=2.0),))
    assert accepted(source, wider, tmp_path / "a", {"by": "her"}) == folder
    assert load_object(folder).tree.joints[0].upper == pytest.approx(2.0)
    assert read_provenance(folder)["by"] == "her"


def test_what_was_left_out_stays_with_an_accepted_asset(tmp_path):
    whole = trimesh.creation.box((1, 0.5, 0.7)).subdivide()
    scan = tmp_path / "box.obj"
    rows = ["v {} {} {}".format(*corner) for corner in whole.vertices.tolist()]
    rows[3] = "v nan nan nan"
    rows += ["f {} {} {}".format(*(face + 1)) for face in whole.faces]
    scan.write_text("\n".join(rows))
    workspace = tmp_path / "workspace"
    opened = open_asset(scan, workspace, ReadOptions())
    labels = tasks.arrays_of(workspace).put((np.arange(opened.element_count) < 2).astype(np.int16))
    folder = accepted(PartSource(opened.folder, workspace, labels), TREE, tmp_path / "a", {})
    (remark,) = read_provenance(folder)["asset"]["remarks"]
    assert remark.startswith(f"1 of {len(whole.vertices)} points")
    assert all(part.remarks == (remark,) for part in load_object(folder).parts)


def test_what_differs_gets_a_draft_of_its_own_and_old_ones_go(source):
    made = [prepare_asset(source, TREE), prepare_asset(replace(source, names={}), TREE)]
    for upper in np.linspace(0.5, 1, DRAFTS_KEPT):
        tree = KinematicTree(TREE.links, (replace(DOOR, upper=float(upper)),))
        made.append(prepare_asset(source, tree))
    assert len(set(made)) == DRAFTS_KEPT + 2
    assert drafts(source) == sorted(p.name for p in made[2:])


def _killed_at(source: PartSource, step: str) -> None:
    def dies(fraction: float, message: str) -> None:
        if message.startswith(step):
            os.kill(os.getpid(), signal.SIGKILL)

    prepare_asset(source, TREE, dies)


@pytest.mark.parametrize("step", ["writing door_1", "Checking the files"])
def test_a_kill_while_preparing_leaves_no_half_draft(source, tmp_path: Path, step):
    child = multiprocessing.get_context("fork").Process(target=_killed_at, args=(source, step))
    child.start()
    child.join()
    assert child.exitcode == -signal.SIGKILL
    assert len(drafts(source)) == 1 and drafts(source)[0].startswith(".")
    folder = accepted(source, TREE, tmp_path / "a", {})
    assert reload_check(folder) == []


def test_a_draft_that_is_asked_for_again_is_not_pushed_out(source):
    first = prepare_asset(source, TREE)
    number = first.stat().st_ino
    for k in range(DRAFTS_KEPT + 1):
        for draft in first.parent.iterdir():
            at = draft.stat().st_mtime - 10
            os.utime(draft, (at, at))
        assert prepare_asset(source, TREE) == first  # as it is when it is accepted
        prepare_asset(replace(source, names={1: f"door {k}"}), TREE)
        assert first.stat().st_ino == number, "it was written anew"
    assert len(drafts(source)) == DRAFTS_KEPT
