"""The port that every export format fits."""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from model.core.articulated_object import ArticulatedObject
from model.core.progress import Progress, no_progress
from model.physics.simulation_values import Physics


@runtime_checkable
class Exporter(Protocol):
    """An articulated object in, files in one folder out.

    Attributes:
        name: what ``--format`` takes.
        description: one human-readable line.
    """

    name: str
    description: str

    def export(
        self,
        obj: ArticulatedObject,
        folder: Path,
        *,
        physics: Physics | None = None,
        progress: Progress = no_progress,
    ) -> tuple[Path, ...]:
        """Write ``obj`` into ``folder``, which exists.

        Files of the same names are replaced. References between the files are relative.

        Args:
            physics: mass, collision shapes and joint dynamics; None leaves shapes and dynamics
                out and takes plain masses.
            progress: reports each part.

        Returns:
            The files, the one to open first.

        Raises:
            ArtiworldError: where the object can't be written in this format.
        """
        ...
