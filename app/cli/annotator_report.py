"""Report of the simulated annotator, by predictor."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

from app.cli.simulated_annotator import BY_HAND, AnnotatorConfig, AnnotatorScore, annotate
from model.core.progress import Progress, no_progress
from model.evaluation.pool import robust_map
from model.evaluation.report import escaped, table

COLUMNS = (
    "predictor", "objects", "right %", "clicks", "part IoU", "wrong joints %", "corrections",
    "commands", "saved %",
)  # fmt: skip


@dataclass(frozen=True)
class AnnotatorReport:
    """Scores of all objects with each predictor, and by hand."""

    config: AnnotatorConfig
    scores: tuple[AnnotatorScore, ...]

    def rows(self) -> list[tuple[str, ...]]:
        """A row for each predictor: means over the objects that were correct in the end.

        ``saved`` is the share of the corrections by hand that the predictor saved, over objects
        that are correct in both.
        """
        return [self._row(name) for name in (*self.config.predictors, BY_HAND)]

    def _row(self, name: str) -> tuple[str, ...]:
        scores = [s for s in self.scores if s.predictor == name]
        right = [s for s in scores if s.right]
        hand = {
            s.object_id: s.corrections for s in self.scores if s.predictor == BY_HAND and s.right
        }
        both = [(s.corrections, hand[s.object_id]) for s in right if s.object_id in hand]
        needed = sum(b for _, b in both)
        saved = 1 - sum(a for a, _ in both) / needed if needed else math.nan
        joints = sum(s.joints for s in right)
        return (
            name,
            str(len(scores)),
            _percent(len(right) / len(scores) if scores else math.nan),
            _mean([s.clicks for s in right]),
            _mean([s.part_iou for s in right], 3),
            _percent(sum(s.wrong for s in right) / joints if joints else math.nan),
            _mean([s.corrections for s in right]),
            _mean([s.commands for s in right]),
            "" if name == BY_HAND else _percent(saved),
        )

    def to_json(self) -> dict[str, Any]:
        """Settings, rows and all scores."""
        rows = [dict(zip(COLUMNS, row, strict=True)) for row in self.rows()]
        settings = {
            k: getattr(self.config, k)
            for k in ("segmenter", "names", "points", "target", "clicks", "seed")
        }
        return {"settings": settings, "rows": rows, "objects": [asdict(s) for s in self.scores]}

    def to_markdown(self) -> str:
        """The table, and the objects that were not correct in the end."""
        lines = ["# The simulated annotator", ""]
        lines += table(COLUMNS, self.rows())
        lines += [
            "",
            "Means over objects that were correct in the end. Clicks until every part's IoU is "
            f"{self.config.target} or {self.config.clicks} clicks per part are spent; corrections "
            "are commands on joints; commands are all of the annotator's; saved is the share of "
            "the corrections by hand that the predictor saved.",
            "",
            "## Not correct in the end",
            "",
        ]
        lines += [
            f"- {escaped(s.object_id)}, {escaped(s.predictor)}: {escaped(s.why)}"
            for s in self.scores
            if not s.right
        ]
        return "\n".join(lines) + "\n"


def annotate_all(
    config: AnnotatorConfig, ids: Sequence[str], jobs: int, progress: Progress = no_progress
) -> AnnotatorReport:
    """Annotate all objects, in parallel."""
    found: dict[str, list[AnnotatorScore]] = {}
    for object_id, scores in robust_map(partial(annotate, config), ids, jobs):
        died = [
            AnnotatorScore(object_id, None, name, why="the process died")
            for name in (*config.predictors, BY_HAND)
        ]
        found[object_id] = scores or died
        progress(len(found) / len(ids), f"{len(found)} of {len(ids)} objects annotated")
    return AnnotatorReport(config, tuple(s for i in ids for s in found[i]))


def _mean(values: Sequence[float], digits: int = 1) -> str:
    return f"{sum(values) / len(values):.{digits}f}" if values else "–"


def _percent(share: float) -> str:
    return "–" if math.isnan(share) else f"{100 * share:.1f}"
