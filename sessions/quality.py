"""Second annotations of objects, unmarked in the queue, their agreement with the first ones, and a
reviewer's daily sample.

An object is annotated a second time as a second object of the workspace: a link to the same file,
where uploads lie, with the name that the next object of its series would have. It shares neither
clicks nor joints with the first. That it is one, and of what, stands only in the table ``meta``,
which neither the screen nor the API reads. Where the first one's accepted asset is to be trusted as
ground truth, the second is a honeypot, else a double annotation.

All choices follow from a seed and the objects' ids, by SHA-256. What was queued before counts, so
running again adds only what new objects ask for.
"""

from __future__ import annotations

import hashlib
import json
import os
import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np
import numpy.typing as npt
from sqlalchemy import insert, select

from model.core.errors import ArtiworldError, StoreError
from model.core.files import free_name, written_to
from model.core.progress import Progress, no_progress
from model.evaluation.agreement import Agreement, agreement, mean_figures
from model.io.assets.reader import load_object, read_provenance
from model.io.model_files import MODEL_SUFFIXES
from sessions.database import Database, ObjectRecord, meta
from sessions.releases import saved_folder
from sessions.statistics import Act, day_of
from sessions.store import Store

Kind = Literal["double", "honeypot"]
_KEY = "second "
"""Stored key prefix, before the id of a second annotation."""
UPLOADS: Final = "uploads"
_WITH_OTHERS = (".obj", ".gltf", ".dae", ".usd", ".usda", ".usdc")
"""Formats that refer to files beside them, besides those of whole models."""


@dataclass(frozen=True)
class Second:
    """A second annotation.

    Attributes:
        object: id of its own object.
        of: id of the first one.
        kind: honeypot where the first is the ground truth.
    """

    object: int
    of: int
    kind: Kind


def seconds_in(database: Database) -> list[Second]:
    """All second annotations of a workspace, by id."""
    wanted = select(meta).where(meta.c.key.startswith(_KEY, autoescape=True))
    with database.reading() as connection:
        rows = connection.execute(wanted).all()
    found = [
        Second(int(row.key.removeprefix(_KEY)), said["of"], said["kind"])
        for row in rows
        for said in (json.loads(row.value),)
    ]
    return sorted(found, key=lambda second: second.object)


def choose(ids: Iterable[int], count: int, seed: str) -> list[int]:
    """``count`` of the ids, evenly by chance, the same ones for the same seed; ascending."""
    return sorted(sorted(ids, key=lambda i: _rank(seed, i))[: max(count, 0)])


def _rank(seed: str, id: int) -> str:
    return hashlib.sha256(f"{seed} {id}".encode()).hexdigest()


def plant(
    store: Store, database: Database, *, share: float = 0.0, honeypots: int = 0, seed: int = 0
) -> list[Second]:
    """Queue objects for a second annotation; returns those that are new.

    Args:
        share: of all objects that is to be annotated twice, 0..1.
        honeypots: number of accepted objects whose asset is taken as the ground truth.
        seed: random seed.

    Raises:
        StoreError: where fewer objects are accepted than there are to be honeypots.
        InputFileError: where the workspace can't be written.
    """
    planted = seconds_in(database)
    copies = {s.object for s in planted}
    records = {
        r.id: r for r in store.objects() if r.id not in copies and _queued(store.workspace, r.path)
    }
    known = {s.of for s in planted}
    accepted = [i for i, r in records.items() if r.state == "accepted"]
    traps, doubles = (sum(s.kind == kind for s in planted) for kind in ("honeypot", "double"))
    free = [i for i in accepted if i not in known]
    if honeypots - traps > len(free):
        raise StoreError(
            f"{store.workspace}: {len(free)} objects are accepted and not annotated twice, too few "
            f"for {honeypots - traps} honeypots; accept more, or ask for fewer"
        )
    new_traps = choose(free, honeypots - traps, f"honeypot {seed}")
    free = [i for i in records if i not in known and i not in new_traps]
    new_doubles = choose(free, round(share * len(records)) - doubles, f"double {seed}")
    return [
        *(_plant(store, database, records[i], "honeypot", seed) for i in new_traps),
        *(_plant(store, database, records[i], "double", seed) for i in new_doubles),
    ]


def _plant(store: Store, database: Database, record: ObjectRecord, kind: Kind, seed: int) -> Second:
    """Queue one object again."""
    folder = store.workspace / UPLOADS / _rank(f"path {seed} {record.path}", record.id)[:16]
    name = next_name(record.name, {r.name for r in store.objects()})
    with written_to(folder, "check space and permissions"):
        folder.mkdir(parents=True)
        path = _link(record.path, folder, name)
    copy = store.open_object(path, record.sha256, name)
    second = Second(copy.id, record.id, kind)
    value = json.dumps({"of": second.of, "kind": kind})
    with database.writing() as connection:
        connection.execute(insert(meta).values(key=f"{_KEY}{second.object}", value=value))
    return second


def next_name(name: str, taken: Collection[str]) -> str:
    """A name as the next object of a series has it: ``oven_12`` after ``oven_03`` and ``oven_11``,
    ``chair_2`` after ``chair``."""
    stem, digits = re.fullmatch(r"(.*?)(\d*)", name, re.DOTALL).groups()  # type: ignore[union-attr]
    if not digits:
        return free_name(name, taken)
    series = re.compile(rf"{re.escape(stem)}(\d{{1,{len(digits) + 2}}})")
    last = max(int(m[1]) for n in {*taken, name} if (m := series.fullmatch(n)))
    return f"{stem}{last + 1:0{len(digits)}}"


def _link(path: Path, folder: Path, name: str) -> Path:
    """Link a source as ``folder``/``name`` where it is one file or a folder.

    A file that refers to others keeps its name, and its folder is linked: readers follow nothing
    that leads out of it.
    """
    if path.is_dir():
        os.symlink(path, folder / name, target_is_directory=True)
        return folder / name
    if path.suffix.lower() in (*MODEL_SUFFIXES, *_WITH_OTHERS):
        os.symlink(path.parent, folder / name, target_is_directory=True)
        return folder / name / path.name
    target = folder / f"{name}{path.suffix}"
    os.symlink(path, target)
    return target


def daily_sample(
    acts: Sequence[Act], day: str, count: int, seed: int = 0
) -> dict[str, tuple[int, ...]]:
    """Person → ids of ``count`` objects that they worked on that day, for a reviewer.

    Args:
        acts: of :func:`sessions.statistics.acts_of`.
        day: ISO 8601, UTC.
    """
    worked: dict[str, set[int]] = {}
    for act in acts:
        if day_of(act.at) == day:
            worked.setdefault(act.who, set()).add(act.object)
    return {
        who: tuple(choose(ids, count, f"sample {seed} {day} {who}"))
        for who, ids in sorted(worked.items())
    }


def _queued(workspace: Path, path: Path) -> bool:
    """True if a file exists and isn't the working file of a scene."""
    inside = path.parts[len(workspace.parts) :] if path.is_relative_to(workspace) else (UPLOADS,)
    return inside[0] in (UPLOADS, "crops") and path.exists()


@dataclass(frozen=True)
class Pair:
    """Two annotations of one object.

    Attributes:
        object, second: ids of the two objects. name, category: of the first.
        kind: honeypot where the first is the ground truth.
        first_by, second_by: who annotated them.
        day: of the second one's acceptance, ISO 8601, UTC.
        agreement: of the two, None where they can't be compared.
        problem: why not, "" where they could.
    """

    object: int
    second: int
    name: str
    category: str
    kind: Kind
    first_by: str
    second_by: str
    day: str
    agreement: Agreement | None = None
    problem: str = ""

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return asdict(self)


def pairs_of(
    store: Store, seconds: Sequence[Second], progress: Progress = no_progress
) -> tuple[list[Pair], list[Second]]:
    """Compare those whose two objects are accepted, largest disagreement first; and the rest."""
    records = {r.id: r for r in store.objects()}
    pairs: list[Pair] = []
    waiting: list[Second] = []
    for k, second in enumerate(seconds):
        one, other = records.get(second.of), records.get(second.object)
        if one is None or other is None:
            continue
        progress(k / len(seconds), one.name)
        if not one.state == other.state == "accepted":
            waiting.append(second)
            continue
        first, again = (store.load(r.id).present for r in (one, other))
        found: Agreement | None = None
        problem = ""
        try:
            folders = [saved_folder(store, r.id) for r in (one, other)]
            if folders[0] is None or folders[1] is None:
                raise ArtiworldError("one of them has no asset")
            found = compared(folders[0], folders[1])
        except ArtiworldError as error:
            problem = str(error)
        known = (one.id, other.id, one.name, one.category or "none", second.kind)
        by = (first.annotator or first.review.by, again.annotator or again.review.by)
        pairs.append(Pair(*known, *by, again.review.at[:10], found, problem))
    return sorted(pairs, key=lambda p: (-_size(p), p.object)), waiting


def _size(pair: Pair) -> float:
    return 2.0 if pair.agreement is None else pair.agreement.disagreement


def compared(one: Path, other: Path) -> Agreement:
    """Compare two saved assets of one source; levelled and sized differently, too.

    Raises:
        InputFileError: where one can't be read.
    """
    frames = [_frame(folder) for folder in (one, other)]
    return agreement(load_object(one), load_object(other), frames[0] @ np.linalg.inv(frames[1]))


def _frame(folder: Path) -> npt.NDArray[np.float64]:
    """(4, 4) from the source file's numbers to the asset."""
    return np.array(read_provenance(folder).get("object_from_source") or np.eye(4))


def summaries(pairs: Iterable[Pair]) -> dict[str, dict[str, dict[str, Any]]]:
    """Means over all, by person (of second annotations) and category, and of these by week.

    A honeypot says how right a person is, a double annotation only how alike two people are; the
    figures by person hold both.
    """
    compared = [p for p in pairs if p.agreement is not None]
    return {
        "all": {"all": _means(compared)},
        "person": _grouped(compared, lambda p: p.second_by),
        "category": _grouped(compared, lambda p: p.category),
        "person and week": _grouped(compared, lambda p: f"{p.second_by} {week_of(p.day)}"),
        "category and week": _grouped(compared, lambda p: f"{p.category} {week_of(p.day)}"),
    }


def _grouped(pairs: list[Pair], key: Callable[[Pair], str]) -> dict[str, dict[str, Any]]:
    names = sorted({key(p) for p in pairs})
    return {name: _means([p for p in pairs if key(p) == name]) for name in names}


def _means(pairs: Sequence[Pair]) -> dict[str, Any]:
    return mean_figures([p.agreement for p in pairs if p.agreement is not None])


def week_of(day: str) -> str:
    """ISO week of a day, such as ``2026-W10``; "" where the day is unknown."""
    if not day:
        return ""
    year, week, _ = date.fromisoformat(day).isocalendar()
    return f"{year}-W{week:02}"
