"""``artiworld train --workspace``: taken over, gone back to, and refused with a reason."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("torch", reason="torch is not installed")

from model.prediction.experience import in_use, load_experience
from sessions.store import Store
from tests.accepted import accept, cupboard
from tests.app.run_cli import answer, artiworld, assert_users_mistake


def accepted(tmp_path: Path, count: int) -> Path:
    """A workspace with cupboards whose doors open by 0.4 rad."""
    store = Store(tmp_path / "w")
    for k in range(count):
        accept(store, tmp_path / f"oven_{k}.ply", cupboard(upper=0.4))
    store.close()
    return tmp_path / "w"


def test_a_workspace_learns_goes_back_and_leaves_objects_out(tmp_path: Path) -> None:
    workspace = accepted(tmp_path, 4)
    record = answer("train", "--workspace", workspace, "--without", "oven_3")
    assert record["taken"] and record["left_out"] == ["oven_3"] and len(record["assets"]) == 3
    assert (record["before"]["usable"], record["after"]["usable"]) == (0, 3)
    folder = in_use(workspace)
    assert folder == workspace / "learned" / "1"
    assert {o.source for o in load_experience(folder / "experience.json").objects} == set(
        record["assets"]
    )
    again = artiworld("train", "--workspace", workspace, "--use", "0")
    assert again.stdout.strip() == "nothing is used" and in_use(workspace) is None
    again = artiworld("train", "--workspace", workspace, "--use", "1")
    assert "version 1" in again.stdout and in_use(workspace) == folder


def test_mistakes_are_named(tmp_path: Path) -> None:
    workspace = accepted(tmp_path, 1)
    train = ("train", "--workspace", workspace)
    assert_users_mistake(artiworld(*train), "1 accepted objects", "it takes 3")
    assert_users_mistake(artiworld(*train, "--without", "boat"), "boat")
    assert_users_mistake(artiworld(*train, "--use", "7"), "no version 7", "none")
    assert_users_mistake(artiworld("train", "--workspace", tmp_path), "no workspace")
    assert_users_mistake(artiworld("train", "--use", "1"), "belong to --workspace")
