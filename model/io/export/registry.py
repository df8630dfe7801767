"""All export formats in one table: built-ins and plug-ins load the same way."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from importlib.metadata import entry_points
from pathlib import Path

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError, InputFileError
from model.core.plug_ins import load_plug_in
from model.core.progress import Progress, no_progress
from model.io.assets.reader import load_object
from model.io.export.protocol import Exporter
from model.physics.simulation_values import Physics

ENTRY_POINTS = "artiworld.exporters"
"""Entry-point group of plug-ins; each names a callable without arguments that gives an Exporter."""


def _urdf() -> Exporter:
    from model.io.export.urdf import UrdfExporter

    return UrdfExporter()


def _mjcf() -> Exporter:
    from model.io.export.mjcf import MjcfExporter

    return MjcfExporter()


def _glb() -> Exporter:
    from model.io.export.glb import GlbExporter

    return GlbExporter()


def _ros() -> Exporter:
    from model.io.export.ros import RosExporter

    return RosExporter()


def _usd() -> Exporter:
    from model.io.export.usd import UsdExporter

    return UsdExporter()


def _sdf() -> Exporter:
    from model.io.export.sdf import SdfExporter

    return SdfExporter()


BUILT_IN: dict[str, Callable[[], Exporter]] = {
    "urdf": _urdf,
    "mjcf": _mjcf,
    "glb": _glb,
    "ros": _ros,
    "usd": _usd,
    "sdf": _sdf,
}


def _table() -> dict[str, Callable[[], Exporter]]:
    table = dict(BUILT_IN)
    for point in entry_points(group=ENTRY_POINTS):
        # A plug-in may not take a built-in's name.
        needs = "name, description and export"
        table.setdefault(point.name, partial(load_plug_in, point, "exporter", Exporter, needs))
    return table


def losses_of(name: str, obj: ArticulatedObject) -> tuple[str, ...]:
    """What readers of a built-in format won't show, in words; empty where nothing is known."""
    from model.io.export import mjcf, part_files, urdf

    told: list[str] = []
    if name in ("urdf", "ros", "sdf"):
        told += part_files.losses_of(obj)
    if name == "urdf":
        told += urdf.losses_of(obj)
    if name == "mjcf":
        told += mjcf.losses_of(obj)
    return tuple(told)


def exporter_names() -> tuple[str, ...]:
    """Names that :func:`load_exporter` takes, built-ins first."""
    return tuple(_table())


def load_exporter(name: str) -> Exporter:
    """The exporter called ``name``.

    Raises:
        ConfigurationError: where there is none, naming those that are there, or where a plug-in
            can't be loaded or is no exporter.
    """
    table = _table()
    if name not in table:
        raise ConfigurationError(f"no export format {name!r}; there are {', '.join(table)}")
    try:
        return table[name]()
    except ImportError as error:  # of a built-in one: an extra isn't installed
        raise ConfigurationError(f"the export format {name!r} can't be loaded: {error}") from error


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
        progress: told of each part.

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
    try:
        out.mkdir(parents=True, exist_ok=True)
        return exporter.export(obj, out, physics=physics, progress=progress)
    except OSError as error:
        raise InputFileError(
            out, f"can't be written ({error.strerror or error})", "check space and permissions"
        ) from error
