"""Statistics: how long people worked, what they did and what it cost."""

from __future__ import annotations

import math
from typing import Any, Literal

from fastapi import APIRouter, Query

from app.server.api.guard import Manager, State
from sessions.command_log import read_work
from sessions.statistics import acts_of, grouped, rows_of

router = APIRouter(tags=["statistics"])


@router.get("/statistics")
def statistics(
    person: Manager,
    state: State,
    by: Literal["person", "category", "predictor", "step", "object", "day"] = "person",
    since: float | None = None,
    rate: float | None = Query(None, gt=0),
) -> list[dict[str, Any]]:
    """Figures for each person, category, …; ``since`` in Unix seconds, ``rate`` for an hour."""
    log = read_work(state.workspace, state.config.database)
    figures = grouped(log, acts_of(log), by, -math.inf if since is None else since)
    return rows_of(figures, by, rate)
