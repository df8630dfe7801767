"""Reports as JSON; :mod:`model.evaluation.markdown` and ``html_report`` format them."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from model.core.errors import InputFileError
from model.core.files import write_json
from model.evaluation.calibration import Calibration, calibrate
from model.evaluation.executability import Execution
from model.evaluation.joint_metrics import JointScore, ObjectScore
from model.evaluation.summary import METRICS, Metric, Summary, bootstrap, summarise

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


def finite(value: Any) -> Any:
    """Replace numbers that aren't finite by None, and tuples by lists."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [finite(v) for v in value]
    return value


def _number(value: float, digits: int) -> str:
    return "–" if math.isnan(value) else f"{value:.{digits}f}"
