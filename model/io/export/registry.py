"""All exporters, and the protocol that each fits.

Built-ins and plug-ins load the same way.
"""

from __future__ import annotations

from pathlib import Path
from typing import Protocol, runtime_checkable

from model.core.articulated_object import ArticulatedObject
from model.core.files import written_to
from model.core.packages import Registry
from model.core.progress import Progress, no_progress
from model.io.assets.reader import load_object
from model.io.export.formats import FORMATS
from model.physics.simulation_values import Physics


@runtime_checkable
class Exporter(Protocol):
    """An articulated object in, files in one folder out.

    Attributes:
        name: what ``--format`` takes.
    """

    name: str

    @property
    def description(self) -> str:
        """One human-readable line."""
        ...

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


EXPORTERS = Registry[Exporter](
    "export format",
    Exporter,
    "name, description and export",
    {name: row.exporter for name, row in FORMATS.items()},
    group="artiworld.exporters",
)
"""All export formats."""


def exporter_names() -> tuple[str, ...]:
    """Names that :func:`load_exporter` takes, built-ins first."""
    return EXPORTERS.names()


def format_title(name: str) -> str:
    """A format's name as people write it: "ROS 2 package" for "ros"."""
    return FORMATS[name].title if name in FORMATS else name


def load_exporter(name: str) -> Exporter:
    """The exporter of a format; see :meth:`~model.core.packages.Registry.load`."""
    return EXPORTERS.load(name)


def export(
    asset: str | Path,
    format: str,
    out: str | Path,
    *,
    physics: Physics | None = None,
    progress: Progress = no_progress,
) -> tuple[Path, ...]:
    """Write a saved asset in another format.

    Args:
        asset: the asset's folder, or a URDF file.
        format: one of :func:`exporter_names`.
        out: folder for the files, created where needed.
        physics: of the asset, see :func:`model.physics.simulation_values.physics_of`.
        progress: reports each part.

    Returns:
        The files, the one to open first.

    Raises:
        ConfigurationError: for an unknown format.
        InputFileError: where the asset can't be read or the folder not written.
    """
    exporter = load_exporter(format)
    return write_object(load_object(asset), exporter, Path(out), physics=physics, progress=progress)


def write_object(
    obj: ArticulatedObject,
    exporter: Exporter,
    out: Path,
    *,
    physics: Physics | None = None,
    progress: Progress = no_progress,
) -> tuple[Path, ...]:
    """Write an object into ``out``, which is created where needed.

    Raises:
        InputFileError: where the folder can't be written.
    """
    with written_to(out, "check space and permissions"):
        out.mkdir(parents=True, exist_ok=True)
        return exporter.export(obj, out, physics=physics, progress=progress)
