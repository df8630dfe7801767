"""One page that holds everything: tables, reliability, and pictures of the worst objects.

Nothing is loaded from elsewhere and nothing runs in it. Every name is escaped.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path

import numpy as np

from model.core.errors import InputFileError
from model.evaluation.calibration import Calibration
from model.evaluation.joint_metrics import ObjectScore
from model.evaluation.pool import robust_map, time_limit
from model.evaluation.report import COLUMNS, Report, faults, paper_rows, show, summary_cells
from model.evaluation.run import EvaluationConfig, judge, load_truth
from model.evaluation.summary import METRICS

STYLE = """
body{font:15px/1.45 system-ui,sans-serif;margin:2rem auto;max-width:72rem;padding:0 1rem;
color:#1d2329;background:#fff}
h1,h2,h3{line-height:1.2}table{border-collapse:collapse;margin:1rem 0;font-size:13.5px}
th,td{padding:.3rem .6rem;border-bottom:1px solid #dde1e6;text-align:right}
th:first-child,td:first-child,.text td,.text th{text-align:left}
tr.own td{font-weight:600}tr.paper td{color:#667}
.worst{display:grid;grid-template-columns:repeat(3,1fr);gap:.6rem;max-width:60rem}
.worst img{width:100%;border:1px solid #e3e6ea;border-radius:4px;background:#fafafa}
figure{margin:0}figcaption{font-size:12.5px;color:#556}.why{max-width:60rem;margin:.2rem 0 1.6rem}
.none{display:flex;align-items:center;justify-content:center;min-height:8rem;color:#889;
border:1px dashed #cdd2d8;border-radius:4px}.note{color:#556;max-width:60rem}
"""


@dataclass(frozen=True)
class Pictures:
    """PNG files of one object; None where there is nothing to draw."""

    given: bytes | None
    truth: bytes | None
    predicted: bytes | None


def write_html(runs: Sequence[tuple[EvaluationConfig, Report]], path: Path, pictures: int) -> Path:
    """Write the page.

    Args:
        runs: each method's configuration and report.
        path: of the page.
        pictures: how many of each method's worst objects are drawn.

    Raises:
        InputFileError: where it can't be written.
    """
    sections = []
    for config, report in runs:
        worst = worst_objects(report.scores, pictures)
        drawn = draw_objects(config, worst)
        sections.append(_section(report, worst, drawn))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(_page([r for _, r in runs], sections), encoding="utf-8")
    except OSError as error:
        raise InputFileError(path, f"can't be written: {error.strerror or error}") from None
    return path


def worst_objects(scores: Sequence[ObjectScore], count: int) -> list[ObjectScore]:
    """Objects that aren't usable, those with the largest share of wrong joints first."""

    def badness(score: ObjectScore) -> tuple[float, float, str]:
        wrong = sum(not j.usable for j in score.joints) + len(score.extra)
        share = wrong / max(1, len(score.joints) + len(score.extra))
        angles = sum(j.apd or 0.0 for j in score.joints)
        return -share - score.tree_edits / max(1, score.parts), -angles, score.object_id

    return sorted((s for s in scores if not s.usable), key=badness)[: max(0, count)]


def draw_objects(
    config: EvaluationConfig, scores: Sequence[ObjectScore]
) -> dict[str, Pictures | None]:
    """Pictures by object id, in parallel; what failed before isn't predicted again."""
    failed = frozenset(s.object_id for s in scores if s.problem)
    ids = [s.object_id for s in scores]
    return dict(robust_map(partial(draw_object, config, failed), ids, config.jobs))


def draw_object(
    config: EvaluationConfig, failed: frozenset[str], object_id: str
) -> Pictures | None:
    """Input, truth and prediction; None where the object can't be read."""
    from model.evaluation import render

    try:
        with time_limit(config.timeout):
            truth = load_truth(config, object_id)
            obj = truth.object
            colors = render.part_colors([p.link for p in obj.parts], obj.tree.root)
            q = render.half_open(obj)
            each = np.stack([p.bounds for p in obj.parts])
            bounds = np.stack([each[:, 0].min(0), each[:, 1].max(0)])
            given = render.png(render.draw(obj, bounds=bounds))
            shown = render.png(render.draw(obj, colors=colors, q=q, joints=True, bounds=bounds))
            if object_id in failed:
                return Pictures(given, shown, None)
            predicted = judge(config, truth).predicted
            if predicted is None:
                return Pictures(given, shown, None)
            image = render.draw(
                predicted, colors=colors, q=render.half_open(predicted), joints=True, bounds=bounds
            )
            return Pictures(given, shown, render.png(image))
    except Exception:  # the boundary of a job: the page says that there is no picture
        return None


def _page(reports: Sequence[Report], sections: Sequence[str]) -> str:
    title = escape(f"Evaluation on {reports[0].dataset}")
    rows = "".join(_row(r.row(), "own") for r in reports)
    rows += "".join(_row(row, "paper") for row in paper_rows())
    head = "".join(f"<th>{escape(c)}</th>" for c in ("method", *COLUMNS))
    return (
        f'<!doctype html><html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width,initial-scale=1">'
        f"<style>{STYLE}</style></head><body><h1>{title}</h1>"
        f"<table><tr>{head}</tr>{rows}</table>"
        '<p class="note">TC, tree and usable count missing and extra joints. APD and ALD in rad, '
        "OPD and DLD in metres. The paper's rows are its own figures on its own objects.</p>"
        f"{''.join(sections)}</body></html>\n"
    )


def _section(
    report: Report, worst: Sequence[ObjectScore], drawn: dict[str, Pictures | None]
) -> str:
    s = report.summary
    figures = []
    for m in METRICS:
        value = show(m, s[m.key])
        low, high = report.intervals[m.key]
        span = "–" if value == "–" else f"{show(m, low)} … {show(m, high)}"
        figures.append(_row((m.label, value, span, m.unit, m.definition, m.source)))
    head = ("figure", "value", "95 % interval", "unit", "what it is", "source")
    categories = "".join(
        _row((f"{c} ({v.objects}, {v.joints})", *summary_cells(v)))
        for c, v in report.by_category.items()
    )
    frame = "" if report.frame is None else f" Frame of the files: {report.frame}."
    return (
        f"<h2>{escape(report.label)}</h2>"
        f"<p>{s.objects} objects, {s.joints} joints; {s.missing} missing, {s.unparseable} "
        f"unparseable, {s.extra} extra, {s.failed} objects without a prediction."
        f"{escape(frame)}</p>"
        f"<details><summary>All figures, with definitions</summary>"
        f'<table class="text">{_header(head)}{"".join(figures)}</table></details>'
        f"<details><summary>By category (objects, joints)</summary>"
        f"<table>{_header(('category', *COLUMNS))}{categories}</table></details>"
        f"{_reliability(report.calibration)}"
        f"<h3>{'The worst objects' if worst else 'Every object is usable'}</h3>"
        f"{''.join(_object(o, drawn.get(o.object_id)) for o in worst)}"
    )


def _object(score: ObjectScore, pictures: Pictures | None) -> str:
    pictures = pictures or Pictures(None, None, None)
    cells = "".join(
        f"<figure>{_image(data, f'{score.object_id}: {what}')}<figcaption>{what}</figcaption>"
        "</figure>"
        for what, data in (
            ("input", pictures.given),
            ("truth, half open", pictures.truth),
            ("prediction, half open", pictures.predicted),
        )
    )
    name = escape(f"{score.object_id} ({score.category or 'unknown'})")
    why = escape("; ".join(faults(score)[:12]))
    if score.execution is not None and score.execution.why:
        why += f"<br>Driven: {escape(score.execution.why)}"
    return f'<h4>{name}</h4><div class="worst">{cells}</div><p class="why">{why}</p>'


def _image(data: bytes | None, alt: str) -> str:
    if data is None:
        return '<div class="none">nothing to draw</div>'
    text = base64.b64encode(data).decode("ascii")
    return f'<img alt="{escape(alt)}" src="data:image/png;base64,{text}">'


def _header(cells: Sequence[str]) -> str:
    return f"<tr>{''.join(f'<th>{escape(c)}</th>' for c in cells)}</tr>"


def _row(cells: Sequence[str], kind: str = "") -> str:
    start = f'<tr class="{kind}">' if kind else "<tr>"
    return f"{start}{''.join(f'<td>{escape(c)}</td>' for c in cells)}</tr>"


def _reliability(c: Calibration) -> str:
    """The reliability curve as a drawing of 260 x 260 units."""
    if not c.joints:
        return ""
    side, edge = 200, 40
    points = [(edge + side * b.confidence, edge + side * (1 - b.usable)) for b in c.bins]
    most = max(b.joints for b in c.bins)
    dots = "".join(
        f'<circle cx="{x:.1f}" cy="{y:.1f}" r="{3 + 6 * (b.joints / most) ** 0.5:.1f}" '
        f'fill="#2980b9"><title>{b.joints} joints</title></circle>'
        for (x, y), b in zip(points, c.bins, strict=True)
    )
    line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
    far = edge + side
    return (
        f"<h3>Confidence</h3><p>{c.joints} joints; expected calibration error {c.ece:.3f}, Brier "
        f'score {c.brier:.3f}.</p><svg width="280" height="280" viewBox="0 0 280 280" role="img" '
        'aria-label="share of usable joints by confidence" font-size="11" fill="#556">'
        f'<rect x="{edge}" y="{edge}" width="{side}" height="{side}" fill="none" stroke="#ccd"/>'
        f'<path d="M{edge} {far}L{far} {edge}" stroke="#99a" stroke-dasharray="4"/>'
        f'<polyline points="{line}" fill="none" stroke="#2980b9"/>{dots}'
        f'<text x="{edge + side / 2}" y="{far + 28}" text-anchor="middle">confidence</text>'
        f'<text x="{edge - 6}" y="{edge + 4}" text-anchor="end">1</text>'
        f'<text x="{edge - 6}" y="{far + 4}" text-anchor="end">0</text>'
        f'<text x="{far}" y="{far + 14}" text-anchor="middle">1</text>'
        f'<text x="{edge}" y="{edge - 10}">share of usable joints</text></svg>'
    )
