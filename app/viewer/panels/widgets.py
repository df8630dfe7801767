"""Small helpers for viser's widgets."""

from __future__ import annotations

from typing import Any


def put(handle: Any, name: str, value: Any) -> None:
    """Assign a widget's property where it differs: nothing is sent twice."""
    if getattr(handle, name) != value:
        setattr(handle, name, value)


def differs(a: tuple[float, ...], b: tuple[float, ...], tolerance: float = 1e-6) -> bool:
    """True if two vectors of a widget differ by more than it shows."""
    return any(abs(x - y) > tolerance for x, y in zip(a, b, strict=True))
