"""Jobs that draw objects of the queue small; see :mod:`app.server.tasks`."""

from __future__ import annotations

import hashlib
import math
from pathlib import Path

from PIL import Image

from app.server.tasks import ReadOptions, stamp
from model.core.articulated_object import ArticulatedObject, Part
from model.core.files import draft_of
from model.core.tree import KinematicTree
from model.evaluation import render
from model.geometry.prepare import moved
from model.io.model_files import is_model
from model.io.open_asset import open_asset

SIZE = (208, 156)
"""Pixels of a thumbnail: a card of the gallery on a sharp screen."""
_VIEW = render.View(azimuth=-math.pi / 2 - 0.6, width=3 * SIZE[0] // 2, height=3 * SIZE[1] // 2)


def draw_thumbnail(path: Path, workspace: Path, options: ReadOptions) -> Path:
    """Draw the object of ``path`` as read with some options, unless that was done before.

    Returns:
        The WebP file in the workspace, named after the content.

    Raises:
        ArtiworldError: where the file can't be read.
    """
    shown = (options.up_axis, options.unit_scale, options.frame, _content(path))
    key = hashlib.sha256(repr(shown).encode()).hexdigest()[:24]
    target = workspace / "thumbnails" / f"{key}.webp"
    if target.exists():
        return target
    asset = open_asset(path, up_axis=options.up_axis, unit_scale=options.unit_scale)
    asset = moved(asset, options.frame.object_from_read)
    whole = Part("link_0", asset.mesh, asset.cloud)
    obj = ArticulatedObject("thumbnail", (whole,), KinematicTree(("link_0",), ()))
    image = render.draw(obj, view=_VIEW).resize(SIZE, Image.Resampling.LANCZOS)
    with draft_of(target) as draft:
        image.save(draft, "WEBP", quality=80)
    return target


def _content(path: Path) -> str:
    """A key of what a file holds; of folders, and files that name others, names and times."""
    if path.is_dir() or is_model(path) or path.suffix.lower() in (".obj", ".gltf"):
        return repr((str(path), stamp(path)))
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
