"""Agreement of the second annotations of a workspace with the first ones."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import ArtiworldError
from model.core.progress import Progress, no_progress
from model.evaluation.agreement import Agreement, agreement, mean_figures
from model.io.assets.reader import load_object, read_provenance
from sessions.quality import Kind, Second
from sessions.releases.contents import saved_folder
from sessions.store import Store


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
        pairs.append(Pair(
            one.id, other.id, one.name, one.category or "none", second.kind,
            first.annotator or first.review.by, again.annotator or again.review.by,
            again.review.at[:10], found, problem,
        ))  # fmt: skip
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
