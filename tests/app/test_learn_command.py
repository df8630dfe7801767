"""``artiworld train --workspace``: taken over, gone back to, and refused with a reason."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from unittest.mock import MagicMock

import pytest

pytest.importorskip("torch", reason="torch is not installed")

from app.server.learning import Learning, learn_from
from model.prediction.experience import in_use, load_experience, versions
from model.training.experience import use
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
    assert folder is not None and folder == workspace / "learned" / "1"
    known = load_experience(folder / "experience.json").objects
    assert {o.source for o in known} == set(record["assets"])
    assert all(o.masks for o in known), "for All parts"
    again = artiworld("train", "--workspace", workspace, "--use", "0")
    assert again.stdout.strip() == "nothing is used" and in_use(workspace) is None
    again = artiworld("train", "--workspace", workspace, "--use", "1")
    assert "version 1" in again.stdout and in_use(workspace) == folder


def test_a_server_learns_as_people_accept_until_one_switches_it_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    workspace = accepted(tmp_path, 2)
    learning = Learning(workspace, None, MagicMock())
    learned = partial(learn_from, workspace, None, automatic=True)
    monkeypatch.setattr(learning, "start", lambda done, automatic: learned())
    store = Store(workspace)
    learning.follow(store.objects())
    accept(store, tmp_path / "oven_3.ply", cupboard(upper=0.4))
    for _ in range(2):
        learning.follow(store.objects())
    folder = in_use(workspace)
    assert folder == workspace / "learned" / "1", "the third is followed, once"
    use(workspace, 0)
    accept(store, tmp_path / "oven_4.ply", cupboard(upper=0.4))
    learning.follow(store.objects())
    assert in_use(workspace) is None and versions(workspace) == [1]
    store.close()


def test_mistakes_are_named(tmp_path: Path) -> None:
    workspace = accepted(tmp_path, 1)
    train = ("train", "--workspace", workspace)
    assert_users_mistake(artiworld(*train), "1 accepted objects", "it takes 3")
    assert_users_mistake(artiworld(*train, "--without", "boat"), "boat")
    assert_users_mistake(artiworld(*train, "--use", "7"), "no version 7", "none")
    assert_users_mistake(artiworld("train", "--workspace", tmp_path), "no workspace")
    assert_users_mistake(artiworld("train", "--use", "1"), "belong to --workspace")
