"""An open object's place in the open scene."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from model.validation.report import ValidationReport


@dataclass(frozen=True, eq=False)
class SceneMember:
    """An object that belongs to a scene.

    Attributes:
        name: of the object in the scene.
        source: returns its source for ``provenance.json``.
        hold: puts its acceptance on hold in the scene, with the reason and the report.
    """

    name: str
    source: Callable[[], Mapping[str, Any]]
    hold: Callable[[str, ValidationReport | None], None]
