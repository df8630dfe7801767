"""Time, clicks and corrections of people, worked out of the command log; a project at a glance.

**Active time.** Each command of a person is an act. Two more acts are known: opening an object,
which begins its reading, and asking for what a command holds only at its end, such as a prediction.
The time between two acts of one person that follow each other, whatever the objects, is active time
of the later act's object and step, where it is at most :data:`PAUSE`. A longer time is a pause, and
counts nothing: nobody knows when the person went away. The arrival of an answer that was asked for
ends one such time and begins the next. What bulk actions do is nobody's time.

**Waiting** is the part of the time between two acts in which a job of the later act's object ran
whose answer the person needs (:data:`sessions.command_log.AWAITED`). It counts in full, beyond
:data:`PAUSE` too, so active time holds it only up to there.
"""

from __future__ import annotations

import bisect
import csv
import io
import itertools
import math
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Final

from sessions.accounts import PROGRAMS
from sessions.command_log import (
    ACCEPT,
    AWAITED,
    BULK,
    PICK,
    LoggedCommand,
    TimedJob,
    WorkLog,
    read_work,
)

PAUSE: Final = 30.0
"""Seconds without an act after which a person counts as away: longer than looking at an object from
all sides takes, shorter than fetching a coffee."""
MASKS = "masks of another system"
"""Author of parts from masks."""
SEGMENTER = "segmenter"
"""Author of the segmenter's answers."""
_SOFTWARE = PROGRAMS | {""}
_RESULTS = frozenset({"record_segmentation", "saved", "placed"})
_SAME_MOMENT = 2.0
"""Seconds between the end of a job and the command that holds its result, at most: it waits for
other callbacks and for the disk."""

STEPS: Final = ("Prepare", "Annotate", "Joints", "Review")
_STEP_OF: Final[Mapping[str, str]] = {
    kind: step
    for step, kinds in (
        ("Prepare", "prepare leave_out crop_out set_frame placed"),
        ("Joints", "record_prediction set_joint set_composite set_root reset_joint lock_joint"),
        ("Review", "set_completion submit accept reject reopen saved decide_objects"),
        ("Review", "add_comment resolve_comment"),
    )
    for kind in kinds.split()
}
"""Command → step; the others belong to Annotate, undo and redo to the step before them."""
_CORRECTIONS = frozenset({"undo", "remove_prompt", "clear_prompts", "delete_part", "reset_joint"})
_JOINT_EDITS = frozenset({"set_joint", "set_composite", "set_root"})
"""Corrections where joints were predicted before."""
_JOB_OF: Final[Mapping[str, str]] = {
    "record_prediction": "predict",
    "apply_tool": "tool",
    "leave_out": "room",
    "crop_out": "room",
    "accept": ACCEPT,
    "add_click": PICK,
    "add_region": PICK,
}
"""Command that holds a job's result → kind of the job."""
BY: Final = ("person", "category", "predictor", "step", "object", "day")


@dataclass(frozen=True)
class Act:
    """One command of a person, with the time that led to it.

    Attributes:
        object: id.
        who: the person.
        at: when it was given or asked for, seconds since 1970.
        kind: of the command.
        step: one of :data:`STEPS`.
        active: seconds that count for it.
        waiting: seconds of waiting for answers on its object before it.
        correction: whether it takes back or changes what was there.
        accepted: whether it is the acceptance that holds now.
        bulk: whether a bulk action gave it, which takes nobody's time.
    """

    object: int
    who: str
    at: float
    kind: str
    step: str
    active: float = 0.0
    waiting: float = 0.0
    correction: bool = False
    accepted: bool = False
    bulk: bool = False


@dataclass(frozen=True)
class Figures:
    """Sums over acts.

    Attributes:
        objects: how many were worked on.
        accepted: how many of them are accepted now.
        active, waiting: seconds.
        clicks: points that were clicked for the segmenter.
        commands: everything that was decided, clicks included.
        corrections: undone steps, removed prompts and parts, edits of predicted joints.
    """

    objects: int = 0
    accepted: int = 0
    active: float = 0.0
    waiting: float = 0.0
    clicks: int = 0
    commands: int = 0
    corrections: int = 0

    @property
    def per_hour(self) -> float:
        """Accepted objects an active hour; NaN before ten of them or an hour, too few to tell."""
        enough = self.active > 0 and (self.accepted >= 10 or self.active >= 3600)
        return 3600 * self.accepted / self.active if enough else math.nan

    @property
    def seconds_each(self) -> float:
        """Active seconds for each accepted object; NaN without any."""
        return self.active / self.accepted if self.accepted else math.nan

    def cost(self, hourly: float) -> float:
        """Cost of the active time, in the currency of ``hourly``."""
        return self.active / 3600 * hourly

    def to_json(self, hourly: float | None = None) -> dict[str, Any]:
        """Plain values; times in seconds, costs where an hour's price is given."""
        out: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        out["active"], out["waiting"] = round(self.active, 1), round(self.waiting, 1)
        out["accepted_per_hour"] = _rounded(self.per_hour)
        out["seconds_per_accepted"] = _rounded(self.seconds_each)
        if hourly is not None:
            out["cost"] = round(self.cost(hourly), 2)
            each = self.cost(hourly) / self.accepted if self.accepted else math.nan
            out["cost_per_accepted"] = _rounded(each)
        return out


def _rounded(value: float) -> float | None:
    return None if math.isnan(value) else round(value, 2)


def acts_of(log: WorkLog) -> list[Act]:
    """All acts of people, in the order of time, with active time and waiting."""
    jobs = _Jobs(log.jobs)
    holding = {
        command.object: command.seq
        for command in log.commands
        if command.kind == "accept" and _state(log, command.object) == "accepted"
    }
    acts: dict[str, list[Act]] = defaultdict(list)
    answers: dict[str, list[tuple[float, int]]] = defaultdict(list)
    step, predicted, object = "Annotate", False, None
    for command in log.commands:
        if command.object != object:
            step, predicted, object = "Annotate", False, command.object
        step = _step(command.kind, step)
        if command.who not in _SOFTWARE and command.kind not in _RESULTS:
            asked = jobs.asked(command)
            if asked < command.at and command.kind != "accept":
                answers[command.who].append((command.at, command.object))
            changed = command.kind in _CORRECTIONS or (predicted and command.kind in _JOINT_EDITS)
            act = Act(command.object, command.who, asked, command.kind, step, correction=changed)
            kept, bulk = holding.get(command.object) == command.seq, jobs.in_bulk(command)
            acts[command.who].append(replace(act, accepted=kept, bulk=bulk))
        predicted |= command.predictor != ""
    found = [a for who in acts for a in _timed(acts[who], answers[who], jobs)]
    return sorted(found, key=lambda act: (act.at, act.object))


def _state(log: WorkLog, object: int) -> str:
    known = log.objects.get(object)
    return "" if known is None else known.state


def _step(kind: str, before: str) -> str:
    return before if kind in ("undo", "redo") else _STEP_OF.get(kind, "Annotate")


def _timed(acts: Iterable[Act], answers: Sequence[tuple[float, int]], jobs: _Jobs) -> Iterable[Act]:
    """The acts of one person with their times.

    Args:
        answers: (moment, object) of answers that came later than they were asked for.
    """
    answers = sorted(answers)
    before, object = -math.inf, -1
    for act in sorted(acts, key=lambda a: (a.at, a.object)):
        if act.bulk:
            yield act
            continue
        first = bisect.bisect_right(answers, (before, math.inf))
        last = bisect.bisect_left(answers, (act.at, -math.inf))
        between = [at for at, of in answers[first:last] if of == object]
        if act.object != object:
            between += jobs.opened(act.object, before, act.at)
        moments = [before, *sorted(between), act.at]
        gaps = [b - a for a, b in itertools.pairwise(moments)]
        active = sum(gap for gap in gaps if gap <= PAUSE)
        waiting = jobs.awaited(act.object, before, act.at)
        yield replace(act, active=active, waiting=waiting)
        before, object = act.at, act.object


class _Jobs:
    """Timed jobs by object and kind."""

    def __init__(self, jobs: Iterable[TimedJob]) -> None:
        self._by: dict[tuple[int, str], list[TimedJob]] = defaultdict(list)
        for job in jobs:
            self._by[job.object, job.kind].append(job)
        for each in self._by.values():
            each.sort(key=lambda job: job.at)
        self._used: set[TimedJob] = set()

    def in_bulk(self, command: LoggedCommand) -> bool:
        """True if a bulk action gave the command."""
        return any(j.at <= command.at <= j.end for j in self._by[command.object, BULK])

    def asked(self, command: LoggedCommand) -> float:
        """When the person asked for what the command records."""
        kind = _JOB_OF.get(command.kind)
        if kind is None:
            return command.at
        for job in reversed(self._by[command.object, kind]):
            fits = job.at <= command.at and abs(command.at - job.end) <= _SAME_MOMENT
            if fits and job not in self._used:
                self._used.add(job)
                return job.at
        return command.at - (command.seconds if kind == "predict" else 0.0)

    def opened(self, object: int, after: float, until: float) -> list[float]:
        """When the object was opened last between two moments; empty where it wasn't."""
        jobs = self._by[object, "open"]
        at = bisect.bisect_left(jobs, until, key=lambda job: job.at) - 1
        return [jobs[at].at] if at >= 0 and jobs[at].at > after else []

    def awaited(self, object: int, after: float, until: float) -> float:
        """Seconds between two moments in which at least one awaited job ran."""
        spans = sorted(
            (max(job.at, after), min(job.end, until))
            for kind in AWAITED
            for job in self._by.get((object, kind), ())
            if job.end > after and job.at < until
        )
        total, done = 0.0, -math.inf
        for begin, end in spans:
            total += max(0.0, end - max(begin, done))
            done = max(done, end)
        return total


def grouped(
    log: WorkLog, acts: Iterable[Act], by: str, since: float = -math.inf
) -> dict[str, Figures]:
    """Figures by one of :data:`BY`, largest active time first; days in their order.

    Args:
        log: names, categories and predictors of the objects.
        acts: of :func:`acts_of`.
        since: acts before it are left out, seconds since 1970.
    """
    key = _key(log, by)
    groups: dict[str, list[Act]] = defaultdict(list)
    for act in acts:
        if act.at >= since:
            groups[key(act)].append(act)
    found = {name: figures_of(each) for name, each in groups.items()}
    if by == "day":
        return dict(sorted(found.items()))
    if by == "step":
        return {s: found[s] for s in STEPS if s in found}
    return dict(sorted(found.items(), key=lambda item: (-item[1].active, item[0])))


def figures_of(acts: Iterable[Act]) -> Figures:
    """The sums over some acts."""
    acts = list(acts)
    return Figures(
        len({a.object for a in acts}),
        len({a.object for a in acts if a.accepted}),
        sum(a.active for a in acts),
        sum(a.waiting for a in acts),
        sum(a.kind == "add_click" for a in acts),
        len(acts),
        sum(a.correction for a in acts),
    )


def day_of(at: float) -> str:
    """The day of a moment, ISO 8601, UTC."""
    return datetime.fromtimestamp(at, UTC).date().isoformat()


def _key(log: WorkLog, by: str) -> Callable[[Act], str]:
    if by == "person":
        return lambda act: act.who
    if by == "step":
        return lambda act: act.step
    if by == "day":
        return lambda act: day_of(act.at)
    if by == "predictor":
        last = {c.object: c.predictor for c in log.commands if c.predictor}
        return lambda act: last.get(act.object, "none")
    if by == "category":
        return lambda act: (log.objects[act.object].category or "none").lower()
    return lambda act: f"{log.objects[act.object].name} ({act.object})"


def duration(seconds: float) -> str:
    """Readable duration: hours and minutes, minutes and seconds, or seconds."""
    whole = round(seconds)
    if whole >= 3600:
        return f"{whole // 3600} h {whole % 3600 // 60:02} min"
    return f"{whole // 60}:{whole % 60:02} min" if whole >= 60 else f"{seconds:.3g} s"


def rows_of(
    figures: Mapping[str, Figures], by: str, hourly: float | None = None
) -> list[dict[str, Any]]:
    """A row for each group, its name under ``by``; see :meth:`Figures.to_json`."""
    return [{by: name, **each.to_json(hourly)} for name, each in figures.items()]


def csv_text(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows with the same keys as CSV; what spreadsheets would calculate is shown as text."""
    out = io.StringIO(newline="")
    writer = csv.writer(out)
    if rows:
        writer.writerow(rows[0])
    for row in rows:
        writer.writerow("" if v is None else _plain(v) for v in row.values())
    return out.getvalue()


def _plain(value: Any) -> Any:
    """Names come from people: "=1+1" is no formula."""
    return f"'{value}" if isinstance(value, str) and value[:1] in set("=+-@\t\r") else value


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
