"""The paper's table and more, as JSON and Markdown."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from model.evaluation.joint_metrics import JointScore, ObjectScore, Summary, summarise

FORMAT_VERSION = 1

PAPER_ROWS: tuple[tuple[str, float, float, float, float, float, float], ...] = (
    ("URDFormer, known categories", 44.6, 0.97, 0.76, 0.82, 1.26, 24.6),
    ("Articulate-Anything, known categories", 59.0, 0.27, 0.32, 0.54, 0.61, 38.1),
    ("Arti4URDF, known categories", 94.9, 0.05, 0.15, 0.08, 0.14, 62.5),
    ("URDFormer, new categories", 23.8, 1.37, 0.92, 1.63, 0.87, 8.3),
    ("Articulate-Anything, new categories", 43.5, 0.48, 0.39, 0.64, 0.66, 33.7),
    ("Arti4URDF, new categories", 89.0, 0.27, 0.20, 0.48, 0.34, 51.8),
)
"""TC %, APD, OPD, ALD, DLD, usable % as printed in *ArtiWorld*, on the paper's own objects."""

COLUMNS = ("TC %", "APD", "OPD", "ALD", "DLD", "usable %", "tree %", "OPD line/diag")


@dataclass(frozen=True)
class Report:
    """Scores of one run.

    Attributes:
        dataset, predictor, names: what was run.
        settings: the whole configuration.
        scores: one an object. seconds: of each prediction.
        wall_seconds: of this run.
    """

    dataset: str
    predictor: str
    names: bool
    settings: dict[str, Any]
    scores: tuple[ObjectScore, ...]
    seconds: tuple[float, ...]
    wall_seconds: float

    @property
    def summary(self) -> Summary:
        """Over all objects."""
        return summarise(self.scores)

    @property
    def by_category(self) -> dict[str, Summary]:
        """Over the objects of each category."""
        groups: dict[str, list[ObjectScore]] = {}
        for s in self.scores:
            groups.setdefault(s.category or "unknown", []).append(s)
        return {c: summarise(groups[c]) for c in sorted(groups)}

    def rows(self) -> list[tuple[str, ...]]:
        """The table: this run first, then the paper's rows, all cells as text."""
        label = f"{self.predictor}, {'with' if self.names else 'without'} names"
        rows = [(f"{label} ({len(self.scores)} objects)", *summary_cells(self.summary))]
        for name, *values in PAPER_ROWS:
            cells = [_number(v, 1 if i in (0, 5) else 2) for i, v in enumerate(values)]
            rows.append((f"{name} [paper's own data]", *cells, "", ""))
        return rows

    def to_json(self) -> dict[str, Any]:
        """All of it, with a format version."""
        return {
            "format_version": FORMAT_VERSION,
            "dataset": self.dataset,
            "predictor": self.predictor,
            "names": self.names,
            "settings": self.settings,
            "wall_seconds": self.wall_seconds,
            "summary": _finite(asdict(self.summary)),
            "by_category": {c: _finite(asdict(s)) for c, s in self.by_category.items()},
            "objects": [
                {**score_to_json(s), "seconds": t}
                for s, t in zip(self.scores, self.seconds, strict=True)
            ],
        }

    def to_markdown(self) -> str:
        """The table, the categories, and the failures in words."""
        s = self.summary
        limits = self.settings.get("limits", {})
        lines = [f"# {self.predictor} on {self.dataset}", ""]
        lines += _markdown_table(("method", *COLUMNS), self.rows())
        lines += [
            "",
            f"{s.objects} objects, {s.joints} joints; {s.missing} missing, {s.extra} extra, "
            f"{s.failed} objects without a prediction. Means over joints; TC, tree and usable "
            "count missing and extra joints. APD and ALD in rad, OPD and DLD in metres.",
            f"With missing joints at the worst value: APD {s.apd_all:.3f}, "
            f"OPD line {s.opd_line_all:.3f}. Type precision {100 * s.type_precision:.1f} %, right "
            f"parent {100 * s.parent:.1f} %, usable joints {100 * s.usable_joints:.1f} %.",
            f"A joint is usable where its type and parent are right, the axis is within "
            f"{limits.get('axis')} rad, the origin within {limits.get('origin')} of the diagonal "
            f"from the true line, and the range overlaps by {limits.get('range_iou')} (IoU) or "
            f"both ends are within {limits.get('angle')} rad or {limits.get('travel')} diagonals.",
            f"Prediction: {_mean(self.seconds):.2f} s an object, at most "
            f"{max(self.seconds, default=0):.2f} s; the run took {self.wall_seconds:.0f} s.",
            "",
            "## By category",
            "",
        ]
        rows = [
            (f"{c} ({v.objects}, {v.joints})", *summary_cells(v))
            for c, v in self.by_category.items()
        ]
        lines += _markdown_table(("category (objects, joints)", *COLUMNS), rows)
        failed = [o for o in self.scores if not o.usable]
        lines += ["", f"## Not usable: {len(failed)} objects", ""]
        lines += [f"- {o.object_id} ({o.category}): {_why(o)}" for o in failed]
        return "\n".join(lines) + "\n"

    def write(self, folder: Path) -> None:
        """Write ``report.json`` and ``report.md``."""
        folder.mkdir(parents=True, exist_ok=True)
        text = json.dumps(self.to_json(), indent=1, allow_nan=False)
        (folder / "report.json").write_text(text + "\n", encoding="utf-8")
        (folder / "report.md").write_text(self.to_markdown(), encoding="utf-8")


def summary_cells(s: Summary) -> tuple[str, ...]:
    """The cells of :data:`COLUMNS`."""
    return (
        _number(100 * s.tc, 1),
        _number(s.apd, 3),
        _number(s.opd, 2),
        _number(s.ald, 2),
        _number(s.dld, 3),
        _number(100 * s.usable, 1),
        _number(100 * s.tree, 1),
        _number(s.opd_line, 3),
    )


def score_to_json(score: ObjectScore) -> dict[str, Any]:
    """One object's score as JSON values."""
    return {**asdict(score), "usable": score.usable}


def score_from_json(data: dict[str, Any]) -> ObjectScore:
    """The inverse of :func:`score_to_json`."""
    rest = {k: v for k, v in data.items() if k not in ("usable", "joints", "extra", "seconds")}
    return ObjectScore(
        joints=tuple(JointScore(**j) for j in data["joints"]),
        extra=tuple((a, b) for a, b in data["extra"]),
        **rest,
    )


def _why(score: ObjectScore) -> str:
    if score.problem:
        return score.problem
    out = [f"{part} should not move ({kind})" for part, kind in score.extra]
    for j in score.joints:
        if j.usable:
            continue
        if not j.type_right:
            out.append(f"{j.child} {j.type} instead of {j.true_type}")
            continue
        faults = []
        if not j.parent_right:
            faults.append("parent")
        if j.apd is not None and j.apd > 0.1:
            faults.append(f"axis {j.apd:.2f} rad")
        if j.opd_line is not None and j.opd_line > 0.05:
            faults.append(f"origin {j.opd_line:.2f}")
        if not j.range_right:
            faults.append("range")
        out.append(f"{j.child} {', '.join(faults)}")
    shown = out[:6]
    return "; ".join(shown) + ("; …" if len(out) > len(shown) else "")


def _markdown_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [
        "| " + " | ".join(header) + " |",
        "|" + "---|" * len(header),
        *("| " + " | ".join(row) + " |" for row in rows),
    ]


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def _finite(values: dict[str, Any]) -> dict[str, Any]:
    return {
        k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in values.items()
    }
