"""``artiworld bench team``: people who work through the API at once."""

from __future__ import annotations

import json

from app.cli.main import main


def test_two_people_click_at_a_server(capfd) -> None:
    code = main(["bench", "team", "--people", "2", "--seconds", "4", "--json"])
    (row,) = json.loads(capfd.readouterr().out)["rows"]
    assert row["people"] == 2 and row["clicks"] >= 2
    assert row["errors"] == code == 0
    assert 0 < row["p50 ms"] <= row["p95 ms"] <= row["longest ms"]
    assert 50 < row["idle MB"] < row["all open MB"]
