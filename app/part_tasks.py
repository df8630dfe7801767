"""Parts cut out of a segmented asset, as the jobs that judge and save take them, and prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from app.tasks import Recent, arrays_of, asset_of
from model.kinematics.articulated_object import (
    ArticulatedObject,
    Part,
    Prediction,
    SegmentedObject,
)
from model.kinematics.joint import Joint
from model.kinematics.tree import KinematicTree
from model.progress import Progress, no_progress


@dataclass(frozen=True)
class PartSource:
    """Everything a worker needs to cut an asset into parts."""

    folder: Path
    workspace: Path
    labels: str
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    title: str = "object"


_cut: Recent[Any, tuple[Part, ...]] = Recent(2)


def parts_of(source: PartSource) -> tuple[Part, ...]:
    """The parts; the last ones are kept, with what others computed for them."""
    from model.geometry.parts import split

    def cut() -> tuple[Part, ...]:
        labels = arrays_of(source.workspace).get(source.labels)
        return split(asset_of(source.folder), labels, source.names)

    names = tuple(sorted(source.names.items()))
    return _cut.get((source.folder, source.labels, names), cut)


def named(part: Part) -> Part:
    """In the app part 0 is the base by definition: the predictor need not guess it."""
    if part.link == "link_0" and part.name is None:
        return replace(part, name="base")
    return part


def segmented_object(source: PartSource) -> SegmentedObject:
    """The parts of an asset as a predictor reads them."""
    return SegmentedObject(source.title, tuple(map(named, parts_of(source))), source.category)


def articulated_object(source: PartSource, tree: KinematicTree) -> ArticulatedObject:
    """The parts of an asset with the joints that were decided."""
    return ArticulatedObject(source.title, parts_of(source), tree, source.category)


def predict(
    source: PartSource,
    predictor: str,
    locked: tuple[Joint, ...],
    seed: int,
    progress: Progress = no_progress,
) -> Prediction:
    """Predict the kinematic tree of the parts."""
    from model.predictors import load_predictor

    progress(0.02, "Cutting out the parts")
    segmented = segmented_object(source)
    return load_predictor(predictor).predict(segmented, locked=locked, seed=seed, progress=progress)
