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
    rgb = from_linear(v[:, :3])
    alpha = v[:, 3:] if v.shape[1] == 4 else np.ones((len(v), 1))
    return np.rint(255 * np.column_stack([rgb, alpha])).astype(np.uint8)


def from_linear(light: Array) -> npt.NDArray[np.float64]:
    """Linear light, 0 or more, as sRGB; values above 1 are brighter than white."""
    return np.where(light <= 0.0031308, 12.92 * light, 1.055 * light ** (1 / 2.4) - 0.055)


def to_linear(srgb: Array) -> npt.NDArray[np.float64]:
    """sRGB, 0 or more, as linear light; 1 stays 1."""
    return np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
