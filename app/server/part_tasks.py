"""Parts cut out of a segmented asset, as the jobs that judge and save take them, and prediction."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.server.tasks import arrays_of, asset_of
from model.core.articulated_object import ArticulatedObject, Part, Prediction, SegmentedObject
from model.core.inertial import Inertial
from model.core.joint import Joint
from model.core.lru_cache import LruCache
from model.core.progress import Progress, no_progress
from model.core.shapes import Shape
from model.core.tree import KinematicTree
from model.geometry.parts import split
from model.physics.collision.build import prepare_bodies as prepare
from model.prediction.registry import load_predictor
from model.segmentation.prompts import BASE


@dataclass(frozen=True)
class PartSource:
    """Everything a worker needs to cut an asset into parts."""

    folder: Path
    workspace: Path
    labels: str
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    title: str = "object"


_cut: LruCache[Any, tuple[Part, ...]] = LruCache(2)


def parts_of(source: PartSource) -> tuple[Part, ...]:
    """The parts; the last ones are kept, with what others computed for them."""

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
    """The parts of an asset with the joints that were decided, and the masses and collision shapes
    that its source tells of parts that are as they were there."""
    inertials, shapes = _told(source)
    return ArticulatedObject(
        source.title, parts_of(source), tree, source.category,
        {k: i for k, i in inertials.items() if k in tree.links},
        {k: held for k, held in shapes.items() if k in tree.links},
    )  # fmt: skip


def _told(source: PartSource) -> tuple[dict[str, Inertial], dict[str, tuple[Shape, ...]]]:
    """Masses and collision shapes by link of those parts that are the source's own."""
    asset = asset_of(source.folder)
    if not (asset.inertials or asset.shapes) or asset.element_part is None:
        return {}, {}
    now = np.maximum(arrays_of(source.workspace).get(source.labels), BASE)
    if now.shape != asset.element_part.shape:
        return {}, {}
    differs = now != asset.element_part
    cut = {*np.unique(now[differs]).tolist(), *np.unique(asset.element_part[differs]).tolist()}
    changed = {f"link_{part}" for part in cut}
    return (
        {link: i for link, i in asset.inertials.items() if link not in changed},
        {link: held for link, held in asset.shapes.items() if link not in changed},
    )


def prepare_bodies(source: PartSource, progress: Progress = no_progress) -> None:
    """Make what judging and saving need of the parts whatever the joints will be."""
    prepare(parts_of(source), source.workspace / "collision", progress, _told(source)[1])


def predict(
    source: PartSource,
    predictor: str,
    locked: tuple[Joint, ...],
    seed: int,
    progress: Progress = no_progress,
) -> Prediction:
    """Predict the kinematic tree of the parts."""
    progress(0.02, "Cutting out the parts")
    segmented = segmented_object(source)
    return load_predictor(predictor).predict(segmented, locked=locked, seed=seed, progress=progress)
