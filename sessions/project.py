"""A project at a glance: its state, today, the last days, and what was worked on last."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from sessions.command_log import WorkLog, read_work
from sessions.statistics import Act, Figures, acts_of, day_of, figures_of

DAYS = 14
"""Days that the plot shows, today included."""
RECENT = 8
"""Objects that are listed as worked on last."""


@dataclass(frozen=True)
class RecentObject:
    """An object that was worked on: who was last, and when (seconds since 1970)."""

    id: int
    name: str
    state: str
    who: str
    at: float


@dataclass(frozen=True)
class Day:
    """A day, ISO 8601, UTC: objects whose acceptance holds, and active seconds of everybody."""

    day: str
    accepted: int
    active: float


@dataclass(frozen=True)
class Overview:
    """Figures of the project page.

    Attributes:
        states: review state → number of objects.
        people: person → figures of today, most active first.
        days: the last :data:`DAYS`, oldest first.
        recent: worked on last, newest first.
        rows: all days of all people, for a table.
    """

    states: Mapping[str, int]
    people: Mapping[str, Figures]
    days: tuple[Day, ...]
    recent: tuple[RecentObject, ...]
    rows: tuple[Mapping[str, object], ...]


def read_overview(workspace: Path, database: str | None, now: float, only: str | None) -> Overview:
    """:func:`overview` of a workspace, as a job of a worker."""
    return overview(read_work(workspace, database), now, only)


def overview(log: WorkLog, now: float, only: str | None = None) -> Overview:
    """Summarise a workspace.

    Args:
        now: seconds since 1970; the days are those of UTC.
        only: whose figures and rows are shown; None for everybody's.
    """
    acts = acts_of(log)
    mine = [a for a in acts if only is None or a.who == only]
    by_day: dict[tuple[str, str], list[Act]] = {}
    for act in mine:
        by_day.setdefault((day_of(act.at), act.who), []).append(act)
    figures = {key: figures_of(each) for key, each in sorted(by_day.items())}
    today = day_of(now)
    people = {who: f for (day, who), f in figures.items() if day == today}
    return Overview(
        Counter(o.state for o in log.objects.values()),
        dict(sorted(people.items(), key=lambda item: (-item[1].active, item[0]))),
        _days(mine, now),
        _recent(log, acts),
        tuple({"day": d, "person": w, **f.to_json()} for (d, w), f in figures.items()),
    )


def _days(acts: list[Act], now: float) -> tuple[Day, ...]:
    last = datetime.fromtimestamp(now, UTC).date()
    names = [(last - timedelta(days=k)).isoformat() for k in reversed(range(DAYS))]
    accepted: Counter[str] = Counter()
    active: Counter[str] = Counter()
    for act in acts:
        day = day_of(act.at)
        accepted[day] += act.accepted
        active[day] += act.active  # type: ignore[assignment]  # seconds
    return tuple(Day(n, accepted[n], float(active[n])) for n in names)


def _recent(log: WorkLog, acts: list[Act]) -> tuple[RecentObject, ...]:
    last: dict[int, Act] = {}
    for act in acts:
        last.pop(act.object, None)
        last[act.object] = act
    return tuple(
        RecentObject(a.object, log.objects[a.object].name, log.objects[a.object].state, a.who, a.at)
        for a in list(reversed(last.values()))[:RECENT]
    )
