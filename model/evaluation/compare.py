"""Compare two runs, figure by figure and object by object; reports on the terminal."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from model.core.errors import ConfigurationError
from model.core.tables import escaped, finite, print_table, table
from model.evaluation.joint_metrics import ObjectScore
from model.evaluation.report import COLUMNS, Report, faults, paper_rows, show
from model.evaluation.summary import (
    METRICS,
    RESAMPLES,
    Summary,
    intervals,
    resampled,
    summarise,
    term_sums,
)

HEADER = ("figure", "before", "after", "difference (95 % interval)", "")
KIND_NAMES = {"broken": "regressed", "mended": "fixed", "changed": "changed"}


@dataclass(frozen=True)
class ObjectChange:
    """An object whose faults differ.

    Attributes:
        kind: "mended" where it became usable, "broken" where it no longer is, else "changed": the
            words of ``comparison.json``; :data:`KIND_NAMES` has their display names.
        gone, new: faults of the first run only, and of the second only.
    """

    object_id: str
    category: str | None
    kind: str
    gone: tuple[str, ...]
    new: tuple[str, ...]


@dataclass(frozen=True)
class Comparison:
    """Two runs on the objects that both have.

    Attributes:
        labels: of the two runs. objects: how many both have; left_out: how many only one has.
        before, after: their figures on the common objects.
        difference: key → after minus before, and its 95 % interval (paired bootstrap).
        changes: objects that differ, regressions first.
    """

    labels: tuple[str, str]
    objects: int
    left_out: int
    before: Summary
    after: Summary
    difference: dict[str, tuple[float, float, float]]
    changes: tuple[ObjectChange, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return finite(
            {
                "runs": self.labels,
                "objects": self.objects,
                "left_out": self.left_out,
                "figures": {
                    m.key: {
                        "before": self.before[m.key],
                        "after": self.after[m.key],
                        "difference": self.difference[m.key][0],
                        "interval_95": self.difference[m.key][1:],
                    }
                    for m in METRICS
                },
                "changes": [
                    {
                        "id": c.object_id,
                        "category": c.category,
                        "kind": c.kind,
                        "gone": c.gone,
                        "new": c.new,
                    }
                    for c in self.changes
                ],
            }
        )

    def rows(self) -> list[tuple[str, ...]]:
        """Figure, before, after, difference with interval, and whether that is better."""
        out = []
        for m in METRICS:
            a, b = self.before[m.key], self.after[m.key]
            if math.isnan(a) and math.isnan(b):
                continue
            delta, low, high = self.difference[m.key]
            clear = low > 0 or high < 0
            word = "" if not clear else ("better" if (delta > 0) == m.higher else "worse")
            span = f"{show(m, delta)} ({show(m, low)} … {show(m, high)})"
            out.append((m.label, show(m, a), show(m, b), span, word))
        return out

    def to_markdown(self) -> str:
        """The comparison as Markdown."""
        a, b = (escaped(label) for label in self.labels)
        kinds = [c.kind for c in self.changes]
        lines = [
            f"# {a} → {b}",
            "",
            f"{self.objects} objects in both, {self.left_out} in one only; "
            f"{kinds.count('mended')} fixed, {kinds.count('broken')} regressed, "
            f"{kinds.count('changed')} otherwise changed.",
            "",
        ]
        lines += table(HEADER, self.rows())
        lines += ["", "## Objects", ""]
        lines += table(
            ("object", "category", "", "gone", "new"),
            [
                (
                    c.object_id,
                    c.category or "unknown",
                    KIND_NAMES[c.kind],
                    "; ".join(c.gone),
                    "; ".join(c.new),
                )
                for c in self.changes
            ],
        )
        return "\n".join(lines) + "\n"


def compare(before: Report, after: Report, *, seed: int = 0) -> Comparison:
    """Compare two runs on their common objects.

    Raises:
        ConfigurationError: where there is none.
    """
    first = {s.object_id: s for s in before.scores}
    second = {s.object_id: s for s in after.scores}
    common = [i for i in first if i in second]
    if not common:
        raise ConfigurationError("the two runs have no object in common; compare runs on one set")
    a, b = [first[i] for i in common], [second[i] for i in common]
    changes = [c for x, y in zip(a, b, strict=True) if (c := _change(x, y)) is not None]
    order = list(KIND_NAMES)
    changes.sort(key=lambda c: (order.index(c.kind), c.object_id))
    return Comparison(
        labels=(before.label, after.label),
        objects=len(common),
        left_out=len(first) + len(second) - 2 * len(common),
        before=summarise(a),
        after=summarise(b),
        difference=_differences(a, b, seed),
        changes=tuple(changes),
    )


def _change(before: ObjectScore, after: ObjectScore) -> ObjectChange | None:
    old, new = faults(before), faults(after)
    if old == new:
        return None
    kind = "changed"
    if before.usable != after.usable:
        kind = "mended" if after.usable else "broken"
    gone = tuple(f for f in old if f not in new)
    return ObjectChange(
        after.object_id, after.category, kind, gone, tuple(f for f in new if f not in old)
    )


def _differences(
    before: Sequence[ObjectScore], after: Sequence[ObjectScore], seed: int
) -> dict[str, tuple[float, float, float]]:
    """Paired: the same objects are drawn for both runs."""
    figures = [summarise(s) for s in (before, after)]
    drawn = [resampled(term_sums(s), seed=seed, resamples=RESAMPLES) for s in (before, after)]
    spans = intervals(drawn[1] - drawn[0])
    return {m.key: (figures[1][m.key] - figures[0][m.key], *spans[m.key]) for m in METRICS}


def print_reports(reports: Sequence[Report]) -> None:
    """The paper's table: a row each run, then the paper's own rows for reference."""
    print_table(
        f"{reports[0].dataset}, {len(reports[0].scores)} objects",
        ("method", *COLUMNS),
        [*(r.row() for r in reports), *paper_rows()],
        styles=["bold"] * len(reports),
        below=map(_words, reports),
    )


def print_comparison(comparison: Comparison) -> None:
    """Figures side by side, and the objects that changed."""
    lines = []
    for c in comparison.changes:
        parts = [f"{KIND_NAMES[c.kind]} {c.object_id}:"]
        parts += [f"gone: {'; '.join(c.gone)}."] if c.gone else []
        parts += [f"new: {'; '.join(c.new)}."] if c.new else []
        lines.append(" ".join(parts))
    a, b = comparison.labels
    title = f"{a} → {b}, {comparison.objects} objects"
    print_table(title, HEADER, comparison.rows(), left=(0, 4), below=lines)


def _words(report: Report) -> str:
    s = report.summary
    low, high = report.intervals["usable"]
    said = (
        f"{report.predictor}: {s.joints} joints: {s.missing} missing, {s.unparseable} unparseable, "
        f"{s.extra} extra; {s.failed} objects failed; usable {100 * s['usable']:.1f} % "
        f"({100 * low:.1f} … {100 * high:.1f}), usable joints {100 * s['usable_joints']:.1f} %, "
        f"parent right {100 * s['parent']:.1f} %, S2O F1 M/MA/MAO {100 * s['m_f1']:.1f}/"
        f"{100 * s['ma_f1']:.1f}/{100 * s['mao_f1']:.1f} %. {report.wall_seconds:.0f} s, "
        f"{sum(report.seconds) / max(1, len(report.seconds)):.2f} s an object."
    )
    return said if report.frame is None else f"{said} Frame of the files: {report.frame}."
