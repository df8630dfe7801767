"""The evaluation as an HTML page: tables, calibration, pictures of failures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from model.core.pool import robust_map, time_limit
from model.core.tables import write_page
from model.evaluation.joint_metrics import ObjectScore
from model.evaluation.report import COLUMNS, Report, faults, figure_row, paper_rows, summary_cells
from model.evaluation.run import EvaluationConfig, load_truth, score_prediction
from model.evaluation.summary import METRICS, Calibration
from model.geometry import drawing

TEMPLATE = Path(__file__).with_name("report.html")


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
    return write_page(
        path,
        TEMPLATE,
        sections=sections,
        metrics=METRICS,
        columns=list(COLUMNS),
        paper=paper_rows(),
        figure=figure_row,
        cells=lambda s: list(summary_cells(s)),
        faults=faults,
    )


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
            colors = drawing.part_colors([p.link for p in obj.parts], obj.tree.root)
            q = drawing.half_open(obj)
            bounds = obj.bounds
            given = drawing.png(drawing.draw(obj, bounds=bounds))
            shown = drawing.png(drawing.draw(obj, colors=colors, q=q, joints=True, bounds=bounds))
            if object_id in failed:
                return Pictures(given, shown, None)
            predicted = score_prediction(config, truth).predicted
            if predicted is None:
                return Pictures(given, shown, None)
            image = drawing.draw(
                predicted, colors=colors, q=drawing.half_open(predicted), joints=True, bounds=bounds
            )
            return Pictures(given, shown, drawing.png(image))
    except Exception:  # the boundary of a job: the page shows no picture then
        return None


def _reliability(c: Calibration) -> list[tuple[str, str, str, int]]:
    """Points x, y of the reliability curve in a square of 200 units, their radii, and joints."""
    most = max((b.joints for b in c.bins), default=1)
    return [
        (
            f"{40 + 200 * b.confidence:.1f}",
            f"{40 + 200 * (1 - b.usable):.1f}",
            f"{3 + 6 * (b.joints / most) ** 0.5:.1f}",
            b.joints,
        )
        for b in c.bins
    ]
