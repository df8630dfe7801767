"""All data sets in one table."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from model.core.errors import ConfigurationError, InputFileError
from model.data.protocol import Dataset


@dataclass(frozen=True)
class DatasetOptions:
    """Where a data set comes from.

    Attributes:
        name: one of :func:`dataset_names`.
        root: its folder; None only for what is made on the fly.
        seed, n, families, fault: of procedural objects made on the fly.
    """

    name: str = "partnet-mobility"
    root: Path | None = None
    seed: int = 0
    n: int = 1
    families: tuple[str, ...] = ()
    fault: str = ""


def _partnet(options: DatasetOptions) -> Dataset:
    from model.data.partnet_mobility import PartNetMobility

    return PartNetMobility(_folder(options))


def _physxnet(options: DatasetOptions) -> Dataset:
    from model.data.physxnet import PhysXNet

    return PhysXNet(_folder(options))


def _urdf(options: DatasetOptions) -> Dataset:
    from model.data.urdf_folders import UrdfFolders

    return UrdfFolders(_folder(options))


def _mjcf(options: DatasetOptions) -> Dataset:
    from model.data.mjcf import MjcfFolder

    return MjcfFolder(_folder(options))


def _procedural(options: DatasetOptions) -> Dataset:
    if options.root is not None:
        from model.data.partnet_mobility import PartNetMobility

        return PartNetMobility(_folder(options), name="procedural")
    from model.data.procedural_set import ProceduralSet

    return ProceduralSet(options.seed, options.n, options.families, fault=options.fault)


BUILT_IN: dict[str, Callable[[DatasetOptions], Dataset]] = {
    "partnet-mobility": _partnet,
    "physxnet": _physxnet,
    "urdf": _urdf,
    "mjcf": _mjcf,
    "procedural": _procedural,
}


def dataset_names() -> tuple[str, ...]:
    """Names that :func:`open_dataset` takes."""
    return tuple(BUILT_IN)


def open_dataset(options: DatasetOptions) -> Dataset:
    """The data set that is asked for.

    Raises:
        ConfigurationError: for an unknown name, or where a folder is needed.
        InputFileError: where the folder isn't there.
    """
    if options.name not in BUILT_IN:
        raise ConfigurationError(
            f"no data set {options.name!r}; there are {', '.join(dataset_names())}"
        )
    return BUILT_IN[options.name](options)


def recognised(root: Path) -> Dataset:
    """The PartNet-Mobility or PhysXNet folder at ``root``, told apart by what is in it.

    Raises:
        InputFileError: where it is neither.
    """
    if not Path(root).is_dir():
        raise InputFileError(root, "no such folder", "give one of PartNet-Mobility or PhysXNet")
    physxnet = (Path(root) / "finaljson").is_dir()
    found = open_dataset(DatasetOptions("physxnet" if physxnet else "partnet-mobility", root))
    try:
        found.ids()
    except InputFileError as error:
        raise InputFileError(
            root,
            "no PartNet-Mobility object (<id>/mobility.urdf) and none of PhysXNet "
            "(finaljson/<id>.json) in it",
        ) from error
    return found


def _folder(options: DatasetOptions) -> Path:
    if options.root is None:
        raise ConfigurationError(f"the data set {options.name} needs --root, its folder")
    if not Path(options.root).is_dir():
        raise InputFileError(options.root, "no such folder", f"give the folder of {options.name}")
    return Path(options.root)
