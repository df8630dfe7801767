"""``artiworld release``: written, compared, imported, and refused with a reason."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from sessions.store import Store
from tests.accepted import accept, cupboard
from tests.app.run_cli import answer, artiworld, assert_users_mistake


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    store = Store(tmp_path / "w")
    accept(store, tmp_path / "oven.ply", cupboard())
    store.close()
    return tmp_path / "w"


def test_releases_are_numbered_compared_and_imported(workspace: Path, tmp_path: Path) -> None:
    said = answer("release", workspace, "--name", "kitchen", "--license", "MIT")
    assert (said["version"], said["license"], len(said["assets"])) == ("1", "MIT", 1)
    store = Store(workspace)
    accept(store, tmp_path / "fridge.ply", cupboard("Refrigerator"))
    accept(store, tmp_path / "oven.ply", cupboard(type="continuous", lower=None, upper=None))
    store.close()
    second = artiworld("release", "create", workspace, "--name", "kitchen", "--json")
    assert json.loads(second.stdout)["version"] == "2"
    home = workspace / "releases"
    done = artiworld("release", "diff", home / "kitchen-1", home / "kitchen-2")
    assert "joints: 1 revolute → 1 continuous" in done.stdout
    assert "1 added, 0 removed, 1 changed, 0 the same" in done.stdout
    into = tmp_path / "theirs"
    done = artiworld("release", "import", home / "kitchen-2", "--into", into, "--json")
    assert [row["name"] for row in json.loads(done.stdout)] == ["fridge-2", "oven-1"]
    only = artiworld("release", workspace, "--name", "k", "--category", "oven", "--json")
    assert [a["category"] for a in json.loads(only.stdout)["assets"]] == ["Oven"]


def test_mistakes_are_named(workspace: Path, tmp_path: Path) -> None:
    wrong = artiworld("release", workspace, "--name", "../up")
    assert_users_mistake(wrong, "--name", "../up", "letters")
    wrong = artiworld("release", workspace, "--name", "k", "--category", "Boat")
    assert_users_mistake(wrong, "Boat", "there are: Oven")
    assert_users_mistake(artiworld("release", tmp_path, "--name", "k"), "no workspace")
    assert_users_mistake(artiworld("release", "diff", tmp_path, tmp_path), "release.json")
    into = tmp_path / "theirs"
    wrong = artiworld("release", "import", tmp_path, "--into", into)
    assert_users_mistake(wrong, "release.json")
    assert not into.exists(), "what is no release makes no workspace"
