"""Reports as JSON and as Markdown. Names come from files and are escaped."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.files import write_json, written_to
from model.core.tables import escaped, finite, table
from model.evaluation.joint_metrics import Execution, JointScore, ObjectScore
from model.evaluation.summary import (
    METRICS,
    Calibration,
    Metric,
    Summary,
    bootstrap,
    calibrate,
    summarise,
)

FORMAT_VERSION = 2
REPORT = "report.json"

PAPER_ROWS: tuple[tuple[str, float, float, float, float, float, float], ...] = (
    ("URDFormer, known categories", 44.6, 0.97, 0.76, 0.82, 1.26, 24.6),
    ("Articulate-Anything, known categories", 59.0, 0.27, 0.32, 0.54, 0.61, 38.1),
    ("Arti4URDF, known categories", 94.9, 0.05, 0.15, 0.08, 0.14, 62.5),
    ("URDFormer, new categories", 23.8, 1.37, 0.92, 1.63, 0.87, 8.3),
    ("Articulate-Anything, new categories", 43.5, 0.48, 0.39, 0.64, 0.66, 33.7),
    ("Arti4URDF, new categories", 89.0, 0.27, 0.20, 0.48, 0.34, 51.8),
)
"""TC %, APD, OPD, ALD, DLD, usable % as printed in *ArtiWorld*, on the paper's own objects."""

COLUMN_KEYS = ("tc", "apd", "opd", "ald", "dld", "usable", "tree", "opd_line")
COLUMNS = tuple(m.label for k in COLUMN_KEYS for m in METRICS if m.key == k)


@dataclass(frozen=True)
class Report:
    """Scores of one run.

    Attributes:
        dataset, predictor: their names. names: whether part names were given; None for written
            predictions.
        settings: the whole configuration.
        scores: one per object. seconds: of each prediction.
        wall_seconds: of this run.
        frame: of written predictions; None for a predictor.
    """

    dataset: str
    predictor: str
    names: bool | None
    settings: dict[str, Any]
    scores: tuple[ObjectScore, ...]
    seconds: tuple[float, ...]
    wall_seconds: float
    frame: str | None = None

    @cached_property
    def summary(self) -> Summary:
        """Over all objects."""
        return summarise(self.scores)

    @cached_property
    def intervals(self) -> dict[str, tuple[float, float]]:
        """95 % bootstrap intervals of :data:`METRICS` by key."""
        return bootstrap(self.scores, seed=int(self.settings.get("seed", 0)))

    @cached_property
    def calibration(self) -> Calibration:
        """Calibration of the predictor's confidences."""
        return calibrate(self.scores)

    @cached_property
    def by_category(self) -> dict[str, Summary]:
        """Over the objects of each category."""
        groups: dict[str, list[ObjectScore]] = {}
        for s in self.scores:
            groups.setdefault(s.category or "unknown", []).append(s)
        return {c: summarise(groups[c]) for c in sorted(groups)}

    @property
    def label(self) -> str:
        """Label of the run in tables."""
        how = "" if self.names is None else f", {'with' if self.names else 'without'} names"
        return f"{self.predictor}{how} ({len(self.scores)} objects)"

    def row(self) -> tuple[str, ...]:
        """This run's row of the table, all cells as text."""
        return (self.label, *summary_cells(self.summary))

    def to_json(self) -> dict[str, Any]:
        """Plain values with a format version; NaN and infinity are null."""
        return {
            "format_version": FORMAT_VERSION,
            "dataset": self.dataset,
            "predictor": self.predictor,
            "names": self.names,
            "frame": self.frame,
            "settings": self.settings,
            "wall_seconds": self.wall_seconds,
            "summary": summary_to_json(self.summary),
            "intervals_95": finite(self.intervals),
            "by_category": {c: summary_to_json(s) for c, s in self.by_category.items()},
            "calibration": finite(asdict(self.calibration)),
            "definitions": {
                m.key: {"unit": m.unit, "definition": m.definition, "source": m.source}
                for m in METRICS
            },
            "objects": [
                {**score_to_json(s), "seconds": t}
                for s, t in zip(self.scores, self.seconds, strict=True)
            ],
        }

    def write(self, folder: Path) -> Path:
        """Write ``report.json``; its path.

        Raises:
            InputFileError: where it can't be written.
        """
        path = folder / REPORT
        write_json(path, self.to_json(), indent=1)
        return path


def read_report(path: Path) -> Report:
    """Read a ``report.json``, or the one in a folder.

    Raises:
        InputFileError: for a missing file or another version.
    """
    path = path / REPORT if path.is_dir() else path
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
        if data["format_version"] != FORMAT_VERSION:
            raise InputFileError(
                path, f"has format {data['format_version']}, not {FORMAT_VERSION}", "run it again"
            )
        return Report(
            dataset=str(data["dataset"]),
            predictor=str(data["predictor"]),
            names=data["names"],
            settings=dict(data["settings"]),
            scores=tuple(score_from_json(o) for o in data["objects"]),
            seconds=tuple(float(o["seconds"]) for o in data["objects"]),
            wall_seconds=float(data["wall_seconds"]),
            frame=data["frame"],
        )
    except OSError as error:
        raise InputFileError(
            path, error.strerror or "can't be read", "give the folder of an evaluation"
        ) from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputFileError(path, f"is no report of an evaluation ({error!r})") from None


def figure_row(report: Report, m: Metric) -> tuple[str, ...]:
    """Label, value, 95 % interval, unit, definition and source of a figure."""
    value = show(m, report.summary[m.key])
    low, high = report.intervals[m.key]
    span = "–" if value == "–" else f"{show(m, low)} … {show(m, high)}"
    return m.label, value, span, m.unit, m.definition, m.source


def paper_rows() -> list[tuple[str, ...]]:
    """The paper's rows for reference, all cells as text."""
    rows = []
    for name, *values in PAPER_ROWS:
        cells = [_number(v, 1 if i in (0, 5) else 2) for i, v in enumerate(values)]
        rows.append((f"{name} [paper's own data]", *cells, "", ""))
    return rows


def summary_cells(s: Summary) -> tuple[str, ...]:
    """The cells of :data:`COLUMNS`."""
    by_key = {m.key: m for m in METRICS}
    return tuple(show(by_key[k], s[k]) for k in COLUMN_KEYS)


def show(metric: Metric, value: float) -> str:
    """Format a figure; shares in per cent."""
    if metric.unit == "%":
        return _number(100 * value, 1)
    return _number(value, 3 if metric.unit in ("rad", "diagonals", "") else 4)


def score_to_json(score: ObjectScore) -> dict[str, Any]:
    """One object's score as JSON values."""
    return {**asdict(score), "usable": score.usable}


def score_from_json(data: Mapping[str, Any]) -> ObjectScore:
    """The inverse of :func:`score_to_json`."""
    apart = ("usable", "joints", "extra", "seconds", "execution")
    rest = {k: v for k, v in data.items() if k not in apart}
    run = data.get("execution")
    return ObjectScore(
        joints=tuple(JointScore(**j) for j in data["joints"]),
        extra=tuple((a, b) for a, b in data["extra"]),
        execution=None if run is None else Execution(**{**run, "kinds": tuple(run["kinds"])}),
        **rest,
    )


def summary_to_json(s: Summary) -> dict[str, Any]:
    """Counts and figures, flat."""
    out = asdict(s)
    return finite({**{k: v for k, v in out.items() if k != "values"}, **out["values"]})


def faults(score: ObjectScore) -> list[str]:
    """Describe the faults of a prediction, joint by joint."""
    if score.problem:
        return [score.problem]
    out = [f"{part} should not move ({kind})" for part, kind in score.extra]
    for j in score.joints:
        if j.usable:
            continue
        if not j.type_right:
            out.append(f"{j.child} {j.type} instead of {j.true_type}")
            continue
        wrong = []
        if not j.parent_right:
            wrong.append("parent")
        if j.apd is not None and j.apd > 0.1:
            wrong.append(f"axis {j.apd:.2f} rad")
        if j.opd_line is not None and j.opd_line > 0.05:
            wrong.append(f"origin {j.opd_line:.2f}")
        if not j.range_right:
            wrong.append("range")
        out.append(f"{j.child} {', '.join(wrong)}")
    return out


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"


MOST_FAULTS = 6


def to_markdown(reports: Sequence[Report]) -> str:
    """Format the table of all runs with the paper's rows, then each run's figures and failures."""
    first = reports[0]
    lines = [f"# Evaluation on {escaped(first.dataset)}", ""]
    rows = [r.row() for r in reports] + paper_rows()
    lines += table(("method", *COLUMNS), rows)
    lines += [
        "",
        "Means over joints; TC, tree and usable count missing and extra joints. APD and ALD in "
        "rad, OPD and DLD in metres. The paper's rows are its own figures on its own objects.",
    ]
    for report in reports:
        lines += _run(report)
    return "\n".join(lines) + "\n"


def write_markdown(reports: Sequence[Report], path: Path) -> Path:
    """Write :func:`to_markdown`.

    Raises:
        InputFileError: where it can't be written.
    """
    with written_to(path):
        path.write_text(to_markdown(reports), encoding="utf-8")
    return path


def _run(report: Report) -> list[str]:
    s = report.summary
    limits = report.settings.get("limits", {})
    lines = ["", f"## {escaped(report.label)}", ""]
    lines.append(
        f"{s.objects} objects, {s.joints} joints; {s.missing} missing, {s.unparseable} "
        f"unparseable, {s.extra} extra, {s.failed} objects without a prediction. "
        f"{_seconds(report)}"
    )
    if report.frame is not None:
        lines.append(f"Frame of the files: {escaped(report.frame)}.")
    lines += [
        f"A joint is usable where its type and parent are right, the axis is within "
        f"{limits.get('axis')} rad, the origin within {limits.get('origin')} of the diagonal from "
        f"the true line, and the range overlaps by {limits.get('range_iou')} (IoU) or both ends "
        f"are within {limits.get('angle')} rad or {limits.get('travel')} diagonals.",
        "",
    ]
    lines += table(
        ("figure", "value", "95 % interval", "unit", "definition", "source"),
        [figure_row(report, m) for m in METRICS],
    )
    lines += _calibration(report)
    lines += ["", "### By category", ""]
    lines += table(
        ("category (objects, joints)", *COLUMNS),
        [
            (f"{c} ({v.objects}, {v.joints})", *summary_cells(v))
            for c, v in report.by_category.items()
        ],
    )
    failed = [o for o in report.scores if not o.usable]
    lines += ["", f"### Not usable: {len(failed)} objects", ""]
    for o in failed:
        found = faults(o)
        more = "; …" if len(found) > MOST_FAULTS else ""
        shown = escaped("; ".join(found[:MOST_FAULTS]))
        lines.append(
            f"- {escaped(o.object_id)} ({escaped(o.category or 'unknown')}): {shown}{more}"
        )
    return lines + _execution(report)


def _execution(report: Report) -> list[str]:
    driven = [(o, o.execution) for o in report.scores if o.execution is not None]
    if not driven:
        return []
    stuck = [(o, run) for o, run in driven if not run.executable]
    kinds: dict[str, int] = {}
    for _, run in stuck:
        for kind in run.kinds:
            kinds[kind] = kinds.get(kind, 0) + 1
    counts = ", ".join(f"{n} {kind}" for kind, n in sorted(kinds.items(), key=lambda k: -k[1]))
    lines = ["", f"### Not executable: {len(stuck)} of {len(driven)} objects", ""]
    lines += [f"Objects by kind of error: {counts}.", ""] if counts else []
    return lines + [f"- {escaped(o.object_id)}: {escaped(run.why)}" for o, run in stuck]


def _seconds(report: Report) -> str:
    mean = sum(report.seconds) / max(1, len(report.seconds))
    return (
        f"{mean:.2f} s an object, at most {max(report.seconds, default=0):.2f} s; the run took "
        f"{report.wall_seconds:.0f} s."
    )


def _calibration(report: Report) -> list[str]:
    c = report.calibration
    if not c.joints:
        return []
    rows = [
        (f"{b.low:.1f}–{b.high:.1f}", str(b.joints), f"{b.confidence:.2f}", f"{100 * b.usable:.0f}")
        for b in c.bins
    ]
    return [
        "",
        "### Confidence",
        "",
        f"{c.joints} joints with a confidence; expected calibration error {c.ece:.3f}, Brier score "
        f"{c.brier:.3f}.",
        "",
        *table(("confidence", "joints", "mean", "usable %"), rows),
    ]
