"""The evaluation as one self-contained HTML page: tables, calibration, pictures of failures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
from jinja2 import Environment, StrictUndefined

from model.core.errors import InputFileError
from model.evaluation import render
from model.evaluation.calibration import Calibration
from model.evaluation.joint_metrics import ObjectScore
from model.evaluation.pool import robust_map, time_limit
from model.evaluation.report import COLUMNS, Report, faults, paper_rows, show, summary_cells
from model.evaluation.run import EvaluationConfig, load_truth, score_prediction
from model.evaluation.summary import METRICS, Metric

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
    """PNG files of one object, or None."""

    given: bytes | None
    truth: bytes | None
    predicted: bytes | None


def write_html(runs: Sequence[tuple[EvaluationConfig, Report]], path: Path, pictures: int) -> Path:
    """Write the page.

    Args:
        runs: each method's configuration and report.
        path: of the page.
        pictures: number of each method's worst objects that are drawn.

    Raises:
        InputFileError: where it can't be written.
    """
    sections = []
    for config, report in runs:
        worst = worst_objects(report.scores, pictures)
        drawn = draw_objects(config, worst)
        objects = [(o, drawn.get(o.object_id) or Pictures(None, None, None)) for o in worst]
        sections.append((report, objects, _reliability(report.calibration)))
    page = _PAGE.render(
        sections=sections, style=STYLE, metrics=METRICS, columns=list(COLUMNS),
        paper=paper_rows(), figure=_figure, cells=lambda s: list(summary_cells(s)),
        faults=faults, png=_data_url,
    )  # fmt: skip
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(page, encoding="utf-8")
    except OSError as error:
        raise InputFileError(path, f"can't be written: {error.strerror or error}") from None
    return path


def worst_objects(scores: Sequence[ObjectScore], count: int) -> list[ObjectScore]:
    """Return objects that aren't usable, those with the largest share of wrong joints first."""

    def badness(score: ObjectScore) -> tuple[float, float, str]:
        wrong = sum(not j.usable for j in score.joints) + len(score.extra)
        share = wrong / max(1, len(score.joints) + len(score.extra))
        angles = sum(j.apd or 0.0 for j in score.joints)
        return -share - score.tree_edits / max(1, score.parts), -angles, score.object_id

    return sorted((s for s in scores if not s.usable), key=badness)[: max(0, count)]


def draw_objects(
    config: EvaluationConfig, scores: Sequence[ObjectScore]
) -> dict[str, Pictures | None]:
    """Draw objects in parallel, by id; failed ones aren't predicted again."""
    failed = frozenset(s.object_id for s in scores if s.problem)
    ids = [s.object_id for s in scores]
    return dict(robust_map(partial(draw_object, config, failed), ids, config.jobs))


def draw_object(
    config: EvaluationConfig, failed: frozenset[str], object_id: str
) -> Pictures | None:
    """Draw input, truth and prediction; None where the object can't be read."""
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
            predicted = score_prediction(config, truth).predicted
            if predicted is None:
                return Pictures(given, shown, None)
            image = render.draw(
                predicted, colors=colors, q=render.half_open(predicted), joints=True, bounds=bounds
            )
            return Pictures(given, shown, render.png(image))
    except Exception:  # the boundary of a job: the page shows no picture then
        return None


_PAGE = Environment(
    autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=StrictUndefined
).from_string("""\
{%- macro row(cells, kind="", tag="td") -%}
<tr{% if kind %} class="{{ kind }}"{% endif %}>
{%- for c in cells %}<{{ tag }}>{{ c }}</{{ tag }}>{% endfor %}</tr>
{%- endmacro -%}
<!doctype html><html lang="en"><head><meta charset="utf-8">
<title>Evaluation on {{ sections[0][0].dataset }}</title>
<meta name="viewport" content="width=device-width,initial-scale=1">
<style>{{ style|safe }}</style></head><body>
<h1>Evaluation on {{ sections[0][0].dataset }}</h1>
<table>{{ row(["method"] + columns, tag="th") }}
{% for report, _, _ in sections %}{{ row(report.row(), "own") }}{% endfor %}
{% for cells in paper %}{{ row(cells, "paper") }}{% endfor %}</table>
<p class="note">TC, tree and usable count missing and extra joints. APD and ALD in rad, OPD and DLD
in metres. The paper's rows are its own figures on its own objects.</p>
{% for report, objects, curve in sections %}
{% set s = report.summary %}
<h2>{{ report.label }}</h2>
<p>{{ s.objects }} objects, {{ s.joints }} joints; {{ s.missing }} missing, {{ s.unparseable }}
unparseable, {{ s.extra }} extra, {{ s.failed }} objects without a prediction.
{%- if report.frame is not none %} Frame of the files: {{ report.frame }}.{% endif %}</p>
<details><summary>All figures, with definitions</summary><table class="text">
{{ row(["figure", "value", "95 % interval", "unit", "definition", "source"], tag="th") }}
{% for m in metrics %}{{ row(figure(report, m)) }}{% endfor %}</table></details>
<details><summary>By category (objects, joints)</summary><table>
{{ row(["category"] + columns, tag="th") }}
{% for name, v in report.by_category.items() %}
{{ row(["%s (%s, %s)" % (name, v.objects, v.joints)] + cells(v)) }}
{% endfor %}</table></details>
{% if curve %}
{% set c = report.calibration %}
<h3>Confidence</h3><p>{{ c.joints }} joints; expected calibration error {{ "%.3f" % c.ece }}, Brier
score {{ "%.3f" % c.brier }}.</p>
<svg width="280" height="280" viewBox="0 0 280 280" role="img"
 aria-label="share of usable joints by confidence" font-size="11" fill="#556">
<rect x="40" y="40" width="200" height="200" fill="none" stroke="#ccd"/>
<path d="M40 240L240 40" stroke="#99a" stroke-dasharray="4"/>
<polyline points="{% for x, y, _, _ in curve %}{{ x }},{{ y }} {% endfor %}" fill="none"
 stroke="#2980b9"/>
{% for x, y, r, joints in curve %}<circle cx="{{ x }}" cy="{{ y }}" r="{{ r }}" fill="#2980b9">
<title>{{ joints }} joints</title></circle>{% endfor %}
<text x="140" y="268" text-anchor="middle">confidence</text>
<text x="34" y="44" text-anchor="end">1</text><text x="34" y="244" text-anchor="end">0</text>
<text x="240" y="254" text-anchor="middle">1</text>
<text x="40" y="30">share of usable joints</text></svg>
{% endif %}
<h3>{{ "The worst objects" if objects else "Every object is usable" }}</h3>
{% for o, pictures in objects %}
<h4>{{ o.object_id }} ({{ o.category or "unknown" }})</h4><div class="worst">
{% for what, data in [("input", pictures.given), ("truth, half open", pictures.truth),
                      ("prediction, half open", pictures.predicted)] %}
<figure>{% if data is none %}<div class="none">no picture</div>{% else %}
<img alt="{{ o.object_id }}: {{ what }}" src="{{ png(data) }}">{% endif %}
<figcaption>{{ what }}</figcaption></figure>
{% endfor %}</div><p class="why">{{ faults(o)[:12]|join("; ") }}
{%- if o.execution and o.execution.why %}<br>Driven: {{ o.execution.why }}{% endif %}</p>
{% endfor %}
{% endfor %}
</body></html>
""")


def _data_url(data: bytes) -> str:
    return f"data:image/png;base64,{base64.b64encode(data).decode('ascii')}"


def _figure(report: Report, m: Metric) -> tuple[str, ...]:
    """A row of the table of all figures."""
    value = show(m, report.summary[m.key])
    low, high = report.intervals[m.key]
    span = "–" if value == "–" else f"{show(m, low)} … {show(m, high)}"
    return m.label, value, span, m.unit, m.definition, m.source


def _reliability(c: Calibration) -> list[tuple[str, str, str, int]]:
    """Points x, y of the reliability curve in a square of 200 units, their radii, and joints."""
    most = max((b.joints for b in c.bins), default=1)
    return [
        (f"{40 + 200 * b.confidence:.1f}", f"{40 + 200 * (1 - b.usable):.1f}",
         f"{3 + 6 * (b.joints / most) ** 0.5:.1f}", b.joints)
        for b in c.bins
    ]  # fmt: skip
