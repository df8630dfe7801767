"""sRGB, as files and screens have it, and the linear light that glTF counts in (IEC 61966-2-1)."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[Any]


def to_srgb(linear: Array) -> npt.NDArray[np.uint8]:
    """Linear RGB(A), floats in 0..1 or whole numbers, as (N, 4) uint8 sRGB; alpha stays linear."""
    v = linear.astype(np.float64)
    if linear.dtype.kind in "iu":
        v = v / np.iinfo(linear.dtype).max
    v = np.clip(np.nan_to_num(v), 0.0, 1.0)
    rgb = v[:, :3]
    rgb = np.where(rgb <= 0.0031308, 12.92 * rgb, 1.055 * rgb ** (1 / 2.4) - 0.055)
    alpha = v[:, 3:] if v.shape[1] == 4 else np.ones((len(v), 1))
    return np.rint(255 * np.column_stack([rgb, alpha])).astype(np.uint8)


def to_linear(srgb: Array) -> npt.NDArray[np.float64]:
    """sRGB in 0..1 as linear light in 0..1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
