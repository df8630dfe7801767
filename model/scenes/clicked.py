"""An object of a scene cut into parts by clicks, made in the scene or kept beside its asset."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial import KDTree

from model.core.articulated_object import Part
from model.core.errors import PromptError
from model.geometry.splitting import split
from model.scenes.asset_parts import AssetParts, bounds_of, read_unshifted
from model.scenes.scene import Anchor, FloatArray, SceneObject
from model.segmentation.prompts import Click, Prompts, Region
from model.segmentation.registry import load_segmenter

FAR = 0.1
"""A click further from the object than this share of its diagonal belongs to something else."""


@dataclass(frozen=True, eq=False)
class ObjectClicks:
    """Clicks of a person on one object.

    Attributes:
        prompts: positions in metres, +z up; elements, where a click or a region names them, are the
            object's own.
        names: part → display name.
        category: of the object, or None.
        segmenter: registered name.
        in_scene: whether positions are the scene's; else the asset's own, before its scale.
    """

    prompts: Prompts
    names: Mapping[int, str] = field(default_factory=dict)
    category: str | None = None
    segmenter: str = "default"
    in_scene: bool = True

    def key(self) -> list[object]:
        """Equal clicks have equal keys."""
        return [self.prompts.key(), sorted(self.names.items()), self.category, self.segmenter]


@dataclass(frozen=True, eq=False)
class ClickedObject:
    """Clicks, and where the object stands that was clicked on."""

    clicks: ObjectClicks
    world_from_object: FloatArray
    anchor: Anchor


def clicked_parts(path: Path, holder: SceneObject, clicks: ObjectClicks) -> AssetParts:
    """Parts in the asset's own frame.

    Args:
        path: of the asset.
        holder: where it stands, and at which size.

    Raises:
        PromptError: where a click is on something else, or no part but the base got anything.
        InputFileError: where the asset can't be read.
    """
    asset = read_unshifted(path)
    placed = holder.placed(bounds_of((Part("link_0", asset.mesh, asset.cloud),)))
    turn, at = placed.world_from_asset[:3, :3], placed.world_from_asset[:3, 3]
    items: list[Click | Region] = list(clicks.prompts.items)
    where = np.array([c.position for c in clicks.prompts.clicks]).reshape(-1, 3)
    local = (where - at) @ turn / placed.scale if clicks.in_scene else where
    away = KDTree(asset.element_centers).query(local)[0] if len(local) else np.zeros(0)
    if len(away) and away.max() > FAR * asset.diagonal:
        worst = int(away.argmax())
        raise PromptError(
            f"clicks[{worst}] at {where[worst].tolist()} is {away[worst]:.3g} m away from it; "
            f"give positions in {'the scene' if clicks.in_scene else 'its frame'}, metres, +z up"
        )
    moved = iter(local.tolist())
    for i, item in enumerate(items):
        if isinstance(item, Click):
            x, y, z = next(moved)
            items[i] = Click((x, y, z), item.part, item.positive, item.element)
    session = load_segmenter(clicks.segmenter).encode(asset)
    answer = session.segment(Prompts(tuple(items)))
    parts = split(asset, answer.labels, clicks.names)
    if len(parts) < 2:
        raise PromptError("the clicks leave it in one part; click on its moving parts")
    return AssetParts(parts, "clicks")
