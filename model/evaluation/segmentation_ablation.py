"""``artiworld bench segment --without``: each mechanism of the segmenter left out by itself.

All run on the same objects by visible clicks, so what a mechanism is worth is what is lost without
it. Most mechanisms are replaced where they are called, by :data:`SWITCHES`, so none knows of this.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import Any, Literal
from unittest.mock import patch

import numpy as np

from model.core.errors import ConfigurationError
from model.core.progress import Progress, no_progress
from model.evaluation.segmentation import BenchConfig, bench_objects
from model.evaluation.segmentation_clicks import BenchObject, picture_of, visible_click_ious
from model.segmentation.default import DefaultSegmenter, DefaultSession
from model.segmentation.facets import FaceGroups
from model.segmentation.models import Trees, load_scorer
from model.segmentation.object_features import HISTORY_FEATURES
from model.segmentation.scores import (
    SCORERS,
    Penalties,
    shipped_moving_scorers,
    shipped_scorers,
)
from model.segmentation.solver import solver_of

ALL = "all"
_WHOLE = "nothing"
"""Name of the segmenter with all mechanisms."""


@dataclass(frozen=True)
class Switch:
    """A mechanism.

    Attributes:
        replaced: attributes below ``model.segmentation``, and their values without it.
        of: objects that have it. anew: the first thing that is made again without it.
    """

    replaced: Mapping[str, Any]
    of: Literal["clouds", "meshes", "both"] = "both"
    anew: Literal["session", "solver", "encoding"] = "session"


def _none(*_: object) -> list[Any]:
    return []


def _nothing(*_: object) -> None:
    return None


def _given(_: object, given: Any, *__: object) -> Any:
    return given


def _no_boxes(self: Any, *_: object) -> Any:
    return np.zeros((0, self._grid.place.shape[1]), bool)


def _weights(**weights: float) -> dict[str, Any]:
    """Other weights of penalties."""
    made = Penalties.for_object
    return {
        "scores.Penalties.for_object": staticmethod(
            lambda *, of_mesh: replace(made(of_mesh=of_mesh), **weights)
        )
    }


def _features(*names: str) -> Switch:
    """Features that perceptrons take at the mean of their training, and trees at 0."""

    def load(path: Any, known: tuple[str, ...]) -> Any:
        scorer = load_scorer(path, known)
        gone = np.isin(scorer.names, names)
        if not isinstance(scorer, Trees):
            return replace(scorer, scale=np.where(gone, 0, scorer.scale).astype(np.float32))
        side = np.where(scorer.threshold < 0, -np.inf, np.inf).astype(np.float32)
        return replace(scorer, threshold=np.where(gone[scorer.feature], side, scorer.threshold))

    return Switch({"scores.load_scorer": load}, anew="solver")


def _no_facets(mesh: Any) -> FaceGroups:
    return FaceGroups(np.full(len(mesh.faces), -1, np.int32), mesh.face_areas, 0)


_NO_BOX = np.zeros((0, 3), np.int16)
SWITCHES: dict[str, Switch] = {
    "boxes": Switch({"boxes.Boxes.first": _none, "boxes.Boxes.later": _none}),
    "boxes between planes": Switch(
        {"boxes.Boxes._between": _no_boxes, "boxes.Boxes._alike": _no_boxes}
    ),
    "boxes like the mask": Switch({"boxes.Boxes._alike": _no_boxes}),
    "boxes behind fronts": Switch({"plane_boxes.BoxGrid.behind": lambda *_: (_NO_BOX, _NO_BOX)}),
    "cuts along boxes": Switch({"boxes.Boxes._cut": _no_boxes}),
    "shells in boxes": Switch({"boxes.Shells.within": lambda _, masks: masks[:0]}, "meshes"),
    "rectangles": Switch(
        {"fronts.FrontRectangles.first": _none, "fronts.FrontRectangles.later": _none}, "clouds"
    ),
    "rectangles apart by lines": Switch({"front_rectangles.EXTRA_RECTANGLES": 0}, "clouds"),
    "even rectangles": Switch({"front_rectangles.PIECES": ()}, "clouds"),
    "walks": Switch({"proposals.Walks.from_clicks": _none, "proposals.Walks.corrected": _given}),
    "walks from clicks": Switch({"proposals.Walks.from_clicks": _none}),
    "corrections by walks": Switch({"proposals.Walks.corrected": _given}),
    "unions": Switch({"proposals.Regions._unions": _none}),
    "trees": Switch({"scores.SCORERS": {**SCORERS, "cloud": SCORERS["mesh"]}}, "clouds", "solver"),
    "scorer of moving parts, first": Switch({"scores._FIRST_WEIGHT": 0.0}, "clouds"),
    "scorer of moving parts, later": Switch({"scores._LATER_WEIGHT": 0.0}, "clouds"),
    "history": _features(*HISTORY_FEATURES),
    "repeats": _features("repeats"),
    "framing": _features("framed_by", "frame_of"),
    "equal neighbours": _features("repeat_1", "repeat_2", "split_upright", "split_level"),
    "handles": Switch(
        {"fronts.Fronts.bar": _nothing, "fronts.Fronts._behind_bar": _none}, "clouds"
    ),
    "handles in lines": Switch({"fronts.HIDDEN": 1.0}, "clouds", "solver"),
    "penalties": Switch(
        {"scores.Penalties.of_first": lambda *_: 0.0, "scores.Penalties.of_later": lambda *_: 0.0}
    ),
    "penalty of idle clicks": Switch({"scores._IDLE": 0.0}),
    "penalty of losses": Switch({"scores._LOSS": 0.0}),
    "penalty of nearly all": Switch({"scores._ALL": 0.0}),
    "penalty of large parts": Switch(_weights(large=0.0, large_beside=0.0)),
    "penalty of small parts": Switch({"scores._SMALL": 0.0}),
    "penalty of details": Switch(_weights(detail=0.0)),
    "penalty of size bounds": Switch({"scores._SIZE": 0.0}),
    "penalty of ineffective clicks": Switch({"scores._INEFFECTIVE": 0.0}),
    "penalty of far changes": Switch(_weights(far=0.0), "clouds"),
    "small components": Switch({"labels.with_small_components": _given}, "clouds"),
    "tidying": Switch({"solver.PartSolver.tidy": _given}),
    "shared superpoints": Switch({"labels.LabelFinisher._divide_superpoints": _nothing}),
    "facets": Switch({"labels.find_facets": _no_facets}, "meshes"),
    "attached shells": Switch(
        {"labels.AttachedShells.attach": _given, "labels.AttachedShells.mount": _nothing}, "meshes"
    ),
    "mounted shells": Switch({"labels.AttachedShells._with_mounted": _given}, "meshes"),
    "trays": Switch({"labels.AttachedShells._with_trays": _given}, "meshes"),
    "handles on meshes": Switch({"labels.AttachedShells.mount": _nothing}, "meshes"),
    "leaving the base": Switch(
        {"session_state.StateUpdates._leaving_base": lambda _, found, *__: found.best}, "meshes"
    ),
    "coincident faces": Switch(
        {"labels.coincident_faces": _nothing, "nodes.coincident_faces": _nothing},
        "meshes",
        "encoding",
    ),
    "outliers": Switch({"nodes._without_outliers": lambda nodes: nodes}, "clouds", "encoding"),
    "denoising": Switch({"nodes.noise_level": lambda *_: 0.0}, "clouds", "encoding"),
    "division by colour": Switch(
        {"superpoints.has_flat_colors": lambda *_: False}, "clouds", "encoding"
    ),
    "edge model": Switch({"default.shipped_edge_model": _nothing}, anew="encoding"),
}


Rounds = list[tuple[float, float]]
"""Of one object, IoU of what is visible and of all after 1, 2 and 3 clicks a part."""


def ablate(
    config: BenchConfig, names: Sequence[str], progress: Progress = no_progress
) -> list[dict[str, Any]]:
    """Measure without each of ``names``, or of all.

    Returns:
        For each data set the figures of the whole segmenter, and without each mechanism that its
        objects have their change and the processor time of all clicks.

    Raises:
        ConfigurationError: for an unknown mechanism.
        ArtiworldError: if an object can't be read.
    """
    chosen = list(SWITCHES) if ALL in names else list(names)
    for name in chosen:
        if name not in SWITCHES:
            known = ", ".join([ALL, *SWITCHES])
            raise ConfigurationError(f"no mechanism {name!r} to leave out; there are {known}")
    out: list[dict[str, Any]] = []
    for data in config.sets:
        found: dict[str, list[tuple[Rounds, float]]] = {}
        for number, item in enumerate(bench_objects(config, data, None)):
            progress(number / max(config.limit or 79, 1) % 1.0, item.name)
            for name, rounds, seconds in _ablated(item, chosen):
                found.setdefault(name, []).append((rounds, seconds))
        mean = {
            name: np.mean([rounds for rounds, _ in all_], axis=0).T for name, all_ in found.items()
        }
        for name, (visible, every) in mean.items():
            before, sign = (0 * mean[_WHOLE], "") if name == _WHOLE else (mean[_WHOLE], "+")
            out.append(
                {
                    "set": data,
                    "without": name,
                    "objects": len(found[name]),
                    "visible": "/".join(f"{v:{sign}.3f}" for v in visible - before[0]),
                    "all": "/".join(f"{v:{sign}.3f}" for v in every - before[1]),
                    "CPU s": round(sum(seconds for _, seconds in found[name]), 1),
                }
            )
    return out


def _ablated(item: BenchObject, names: Sequence[str]) -> Iterator[tuple[str, Rounds, float]]:
    """All mechanisms, then each that concerns an object left out: its name, the rounds of visible
    clicks, and processor time of these. Nothing for an object without visible parts.
    """
    picture, mesh = picture_of(item.asset, item.front), item.asset.mesh
    weight = (np.ones(len(item.labels)) if mesh is None else mesh.face_areas) * (item.labels >= 0)
    whole = DefaultSegmenter().encode(item.asset)
    for name in (_WHOLE, *names):
        switch = SWITCHES.get(name, Switch({}))
        if switch.of == ("meshes" if mesh is None else "clouds"):
            continue
        with ExitStack() as stack:
            for target, value in switch.replaced.items():
                stack.enter_context(patch(f"model.segmentation.{target}", value))
            for cached in (shipped_scorers, shipped_moving_scorers):
                cached.cache_clear()
                stack.callback(cached.cache_clear)
            if switch.anew == "encoding":
                session = DefaultSegmenter().encode(item.asset)
            else:
                solver = whole.solver
                if switch.anew == "solver":
                    scorers = shipped_scorers("mesh" if whole.encoding.nodes.of_mesh else "cloud")
                    solver = solver_of(whole.encoding, *scorers, shipped_moving_scorers())
                session = DefaultSession(item.asset, whole.encoding, solver)
            begin = time.process_time()
            rounds = visible_click_ious(session, picture, item.labels, weight)
            if not rounds:
                return
            yield name, rounds, time.process_time() - begin
