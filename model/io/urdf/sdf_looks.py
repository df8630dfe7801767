"""Looks of an SDF's visuals: colours, the picture of PBR, transparency."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from model.core.geometry import Material
from model.core.textures import TextureError, open_texture
from model.io.urdf.sdf_frames import numbers_in, said

if TYPE_CHECKING:
    from xml.etree.ElementTree import Element

LOOKS = "{sdf}material"
"""The ``<material>`` of an SDF within a URDF's visual, which has the transparency, too."""
ALBEDO = "albedo_map"
"""What is read of ``<metal>``."""


def painted(
    looks: Element, resolve: Callable[[str], Path | None], notes: list[str], where: str
) -> Material | None:
    """The material of a visual; None where it tells no colour and no picture.

    Args:
        looks: a :data:`LOOKS`.
        resolve: finds a file that it names; None where it can't.
        notes: gets what isn't read.
        where: of the visual, for the notes.

    Raises:
        ValueError: for a colour of anything but three or four numbers.
    """
    script = said(looks, "script/name")
    color = _rgba(looks, "diffuse") or _rgba(looks, "ambient")
    if script:
        notes.append(f"{where}: the material script {script!r} is not read")
    picture = None
    text = said(looks, f"pbr/metal/{ALBEDO}")
    file = resolve(text) if text else None
    if file is not None:
        try:
            picture = open_texture(file)
        except TextureError as error:
            notes.append(f"{where}: {error}")
    clear = said(looks, "transparency")
    opacity = 1 - float(np.clip(numbers_in(clear, 1, "transparency")[0], 0, 1)) if clear else 1.0
    if not color and picture is None:
        if opacity < 1:
            notes.append(f"{where}: transparency without a colour is not read")
        return None
    if not color or (picture is not None and not any(color[:3])):  # the default is black
        color = (1.0, 1.0, 1.0)
    r, g, b, a = (round(255 * v) for v in (*color, 1.0)[:4])
    return Material(script or "sdf", (r, g, b, round(a * opacity)), picture)


def _rgba(looks: Element, key: str) -> tuple[float, ...]:
    """Three or four numbers from 0 to 1; none where it says no colour."""
    text = said(looks, key)
    count = 4 if len(text.split()) > 3 else 3
    return tuple(np.clip(numbers_in(text, count, key), 0, 1).tolist()) if text else ()
