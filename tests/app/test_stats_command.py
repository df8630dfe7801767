"""``artiworld stats`` on a workspace with known times."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import pytest

from model.segmentation.prompts import Click
from sessions import commands as cmd
from sessions.store import Store
from tests.app.run_cli import answer, artiworld, assert_users_mistake


@pytest.fixture
def workspace(tmp_path: Path) -> Path:
    store = Store(tmp_path / "w")
    id = store.open_object(tmp_path / "oven.ply", None, "oven").id
    for k, who in enumerate(("anna", "anna", "ben")):
        click = cmd.AddClick(Click((0.1 * k, 0.0, 0.0), k + 1))
        store.append(id, click, who, k, at=f"2026-03-0{2 + k // 2}T09:00:{10 * k:02}.000000Z")
    store.close()
    return tmp_path / "w"


def test_rows_by_person_cost_and_csv(workspace: Path, tmp_path: Path) -> None:
    table = tmp_path / "rows.csv"
    anna, ben = answer("stats", workspace, "--rate", "36", "--csv", table)
    assert (anna["person"], anna["active"], anna["clicks"], anna["cost"]) == ("anna", 10.0, 2, 0.1)
    assert (ben["person"], ben["active"], ben["accepted_per_hour"]) == ("ben", 0.0, None)
    with table.open(newline="") as file:
        assert [row["person"] for row in csv.DictReader(file)] == ["anna", "ben"]
    late = artiworld("stats", workspace, "--since", "2026-03-03", "--by", "day", "--json")
    assert [row["day"] for row in json.loads(late.stdout)] == ["2026-03-03"]
    shown = artiworld("stats", workspace, "--by", "step").stdout
    assert "Annotate" in shown and "10 s" in shown


def test_what_is_no_workspace_or_no_day(workspace: Path, tmp_path: Path) -> None:
    missing = tmp_path / "missing"
    assert_users_mistake(artiworld("stats", missing), str(missing), "no workspace")
    assert not missing.exists(), "asking doesn't make one"
    wrong = artiworld("stats", workspace, "--since", "yesterday")
    assert_users_mistake(wrong, "--since", "yesterday", "2026-01-31")
    assert_users_mistake(artiworld("stats", workspace, "--rate", "-1"), "--rate")
    unwritable = artiworld("stats", workspace, "--csv", tmp_path / "no" / "rows.csv")
    assert_users_mistake(unwritable, "rows.csv", "can't be written")
