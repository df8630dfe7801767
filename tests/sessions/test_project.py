"""The project page's figures from a log with known days."""

from datetime import timedelta
from pathlib import Path

from sessions import commands as cmd
from sessions.command_log import read_work
from sessions.statistics import DAYS, overview
from sessions.store import Store
from tests.accepted import BEGIN, accept, cupboard


def test_states_people_days_and_recent_objects(store: Store, tmp_path: Path) -> None:
    accept(store, tmp_path / "oven.ply", cupboard(), "anna", day=0)
    accept(store, tmp_path / "chair.ply", cupboard("Chair"), "ben", day=2)
    chest = store.open_object(tmp_path / "chest.ply", None, "chest").id
    noon = (BEGIN + timedelta(days=2, hours=3)).strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    store.append(chest, cmd.SetCategory("Chest"), "anna", 0, at=noon)
    now = (BEGIN + timedelta(days=2, hours=6)).timestamp()
    found = overview(read_work(store.workspace), now)
    assert dict(found.states) == {"accepted": 2, "in_progress": 1}
    assert {who: f.accepted for who, f in found.people.items()} == {"ben": 1, "anna": 0}
    assert list(found.people) == ["ben", "anna"], "most active first"
    assert len(found.days) == DAYS and found.days[-1].day == "2026-03-04"
    assert [(d.accepted, d.active) for d in found.days[-3:]] == [(1, 20.0), (0, 0.0), (1, 20.0)]
    assert [r.name for r in found.recent] == ["chest", "chair", "oven"]
    days = [(r["day"].removeprefix("2026-03-"), r["person"]) for r in found.rows]
    assert days == [("02", "anna"), ("04", "anna"), ("04", "ben")]
    alone = overview(read_work(store.workspace), now, only="anna")
    assert list(alone.people) == ["anna"] and {r["person"] for r in alone.rows} == {"anna"}
    assert [d.accepted for d in alone.days[-3:]] == [1, 0, 0]


def test_an_empty_workspace_has_an_empty_page(store: Store) -> None:
    found = overview(read_work(store.workspace), BEGIN.timestamp())
    assert (dict(found.states), found.people, found.recent, found.rows) == ({}, {}, (), ())
    assert sum(d.accepted for d in found.days) == 0
