"""Array checks shared by the geometric types."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from model.core.errors import GeometryError

FloatArray = npt.NDArray[np.floating[Any]]
IntArray = npt.NDArray[np.integer[Any]]


def frozen(array: npt.ArrayLike, dtype: npt.DTypeLike, columns: int | None, what: str) -> Any:
    """A read-only array of ``dtype``; (N,) where ``columns`` is None, else (N, columns).

    Copies only where the input is not already read-only of that type.

    Raises:
        GeometryError: on a wrong shape, NaN or infinity.
    """
    out = np.asarray(array, dtype=dtype)
    if columns is None:
        if out.ndim != 1:
            raise GeometryError(f"{what} must have shape (N,), got {out.shape}")
    elif out.ndim != 2 or out.shape[1] != columns:
        raise GeometryError(f"{what} must have shape (N, {columns}), got {out.shape}")
    if np.issubdtype(out.dtype, np.floating) and not np.isfinite(out).all():
        bad = int((~np.isfinite(out)).reshape(len(out), -1).any(axis=1).sum())
        raise GeometryError(f"{what}: {bad} of {len(out)} rows are NaN or infinite")
    if out.flags.writeable:
        out = np.ascontiguousarray(out) if out.base is not None or not out.flags.owndata else out
        if out is array:
            out = out.copy()
        out.flags.writeable = False
    return out
