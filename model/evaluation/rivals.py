"""Methods side by side on the same objects: figures, geometry kept, seconds, pictures.

Ours, geometry alone and the plain baseline get the true parts with their names, as ``evaluate``
gives them. Of every other method the URDFs are read that lie in a folder called after it. Seconds
are the prediction's own; a written one tells them in ``seconds.json`` (id → seconds) of its folder.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import write_json
from model.core.geometry import merged, merged_clouds
from model.core.pool import robust_map, time_limit
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tables import write_page
from model.data.folders import urdf_files
from model.data.registry import DatasetOptions
from model.evaluation.html_report import Pictures, draw_objects
from model.evaluation.predictions import LONGEST_EDGE
from model.evaluation.report import PAPER_ROWS, Report
from model.evaluation.run import (
    EvaluationConfig,
    chosen_ids,
    evaluate,
    find_frame,
    load_truth,
    score_prediction,
    spread,
)
from model.evaluation.summary import METRICS
from model.geometry.sampling import sample_surface
from model.io.model_files import safe_link
from model.prediction.registry import DEFAULT

TEMPLATE = Path(__file__).with_name("rivals.html")
OURS = {"ours": DEFAULT, "geometry alone": "geometric", LONGEST_EDGE: LONGEST_EDGE}
"""Label → predictor of the methods that are in every page."""
FIGURES = ("tc", "apd", "opd", "ald", "dld", "usable", "m_f1", "ma_f1", "mao_f1", "part_iou",
           "executable")  # fmt: skip
"""The paper's, S2O's, and whether it moves; keys of :data:`METRICS`."""
WORK = ".rivals"
"""Folder of our own runs below the root, from which a stopped one resumes."""
SAMPLES = 8000
"""Points on each surface that is compared."""


@dataclass(frozen=True, eq=False)
class Rival:
    """One method's row.

    Attributes:
        kept: of each object with a prediction, see :func:`geometry_kept`.
        pictures: of some objects.
        seconds: an object's mean; NaN where nobody tells.
    """

    label: str
    report: Report
    kept: Sequence[tuple[float, float]] = ()
    pictures: Mapping[str, Pictures | None] = field(default_factory=dict)
    seconds: float = math.nan

    def figures(self) -> dict[str, float]:
        """Label → value; shares are 0..1, NaN where there is nothing to average."""
        out = {m.label: self.report.summary[k] for k in FIGURES for m in METRICS if m.key == k}
        chamfer, color = np.mean(self.kept, axis=0).tolist() if self.kept else (math.nan, math.nan)
        return {**out, "chamfer": chamfer, "color": color, "s": self.seconds}

    def cells(self) -> list[str]:
        """The row as text."""
        return [
            self.label,
            *(
                "–" if not math.isfinite(v) else f"{100 * v:.1f}" if "%" in k else f"{v:.3g}"
                for k, v in self.figures().items()
            ),
        ]


def methods_in(root: Path) -> dict[str, Path]:
    """Name → folder of each method whose URDFs lie below ``root``.

    Raises:
        InputFileError: where the folder isn't there.
        ConfigurationError: where a folder has a name of :data:`OURS`.
    """
    if not root.is_dir():
        raise InputFileError(root, "no such folder", "give one with a folder a method in it")
    found = {
        folder.name: folder
        for folder in sorted(root.iterdir())
        if folder.is_dir() and not folder.name.startswith(".") and urdf_files(folder)
    }
    own = sorted(set(found) & set(OURS))
    if own:
        raise ConfigurationError(f"{root / own[0]}: {own[0]!r} is in every page; rename the folder")
    return found


def compare_rivals(
    data: DatasetOptions,
    root: Path,
    *,
    limit: int | None = None,
    pictures: int = 8,
    jobs: int = 2,
    drive: bool = True,
    progress: Progress = no_progress,
) -> list[Rival]:
    """Score every method and write ``rivals.html`` and ``rivals.json`` into ``root``.

    Args:
        data: the objects. limit: most of them, spread over all.
        pictures: objects that are drawn. jobs: processes. drive: whether joints are driven.
    """
    base = EvaluationConfig(data, limit=limit, jobs=jobs, execute=drive)
    configs = {label: replace(base, predictor=name) for label, name in OURS.items()}
    for label, folder in methods_in(root).items():
        configs[label] = replace(base, predictor=label, predictions=folder)
    ids = chosen_ids(base)
    rivals = []
    for i, (label, config) in enumerate(configs.items()):
        # Written ones may change until the next run.
        out = root / WORK / safe_link(label) if config.predictions is None else None
        span = scaled_progress(progress, i / len(configs), (i + 0.8) / len(configs))
        rivals.append(_rival(label, replace(config, out=out), ids, spread(ids, pictures), span))
        progress((i + 1) / len(configs), f"{label} is done")
    write_page(
        root / "rivals.html",
        TEMPLATE,
        rivals=rivals,
        drawn=spread(ids, pictures),
        data=data.name,
        count=len(ids),
        columns=["method", *rivals[0].figures()],
        # The paper has no other column.
        paper=[[f"{n} (paper)", *row, *["–"] * (len(FIGURES) - 3)] for n, *row in PAPER_ROWS],
        definitions=[m for m in METRICS if m.key in FIGURES],
    )
    write_json(root / "rivals.json", to_json(rivals), indent=1)
    return rivals


def to_json(rivals: Sequence[Rival]) -> dict[str, Any]:
    """Figures by method; None where there is nothing to average."""
    return {
        r.label: {k: v if math.isfinite(v) else None for k, v in r.figures().items()}
        | {
            "objects": len(r.report.scores),
            "failed": r.report.summary.failed,
            "frame": r.report.frame,
        }
        for r in rivals
    }


def _rival(
    label: str, config: EvaluationConfig, ids: list[str], drawn: list[str], progress: Progress
) -> Rival:
    if (folder := config.predictions) is not None:
        config = replace(config, frame=find_frame(config, ids))
    report = evaluate(config, progress=progress)
    seconds = float(np.mean(report.seconds)) if folder is None else _seconds(folder, ids)
    found = robust_map(partial(_kept, config), ids, config.jobs)
    kept = [pair for _, pair in found if pair is not None]
    shown = draw_objects(config, [s for s in report.scores if s.object_id in drawn])
    return Rival(label, report, kept, shown, seconds)


def _seconds(folder: Path, ids: list[str]) -> float:
    path = folder / "seconds.json"
    if not path.is_file():
        return math.nan
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
        values = [float(table[i]) for i in ids if i in table]
    except (ValueError, TypeError) as error:
        raise InputFileError(path, f"tells no seconds: {error}", 'as in {"100234": 12.5}') from None
    return float(np.mean(values)) if values else math.nan


def _kept(config: EvaluationConfig, object_id: str) -> tuple[float, float] | None:
    """Geometry kept by one prediction; None without any, which its score tells."""
    try:
        with time_limit(config.timeout):
            truth = load_truth(config, object_id)
            found = score_prediction(config, truth).predicted
            return None if found is None else geometry_kept(truth.object, found)
    except Exception:  # the boundary of a job
        return None


def geometry_kept(truth: ArticulatedObject, found: ArticulatedObject) -> tuple[float, float]:
    """Chamfer distance over the true diagonal, and mean difference of colours (0..1), at rest.

    Each surface is sampled with the same seed, so the input's own geometry gives 0.
    """
    (a, color_a), (b, color_b) = _sampled(truth), _sampled(found)
    diagonal = float(np.linalg.norm(np.ptp(a, axis=0))) or 1.0
    there, nearest = KDTree(b).query(a)
    back = KDTree(a).query(b)[0]
    color = np.abs(color_a - color_b[nearest]).mean() / 255
    return float(there.mean() + back.mean()) / 2 / diagonal, float(color)


def _sampled(obj: ArticulatedObject) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) points and (N, 3) RGB; grey where the object has no colours."""
    meshes = [p.mesh for p in obj.parts if p.mesh is not None and p.mesh.face_areas.sum() > 0]
    clouds = [p.cloud for p in obj.parts if p.cloud is not None and p.mesh is None]
    rng = np.random.default_rng(0)
    whole = [sample_surface(merged(meshes), SAMPLES, rng)[0]] if meshes else []
    if clouds:
        cloud = merged_clouds(clouds)
        whole.append(cloud.take(rng.permutation(len(cloud))[:SAMPLES]))
    points = np.concatenate([c.points for c in whole]).astype(np.float64)
    grey = [np.full((len(c), 3), 128.0) if c.colors is None else c.colors[:, :3] for c in whole]
    return points, np.concatenate(grey).astype(np.float64)
