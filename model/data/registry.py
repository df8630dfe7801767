"""All data sets in one table."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from model.core.errors import ConfigurationError, InputFileError
from model.core.packages import Registry
from model.data.datasets import Dataset


@dataclass(frozen=True)
class DatasetOptions:
    """Location or generator of a data set.

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


DATASETS = Registry[Dataset](
    "data set",
    Dataset,
    "name, ids, category and load",
    {
        "partnet-mobility": "model.data.folders:PartNetMobility",
        "physxnet": "model.data.physxnet:PhysXNet",
        "urdf": "model.data.folders:UrdfFolders",
        "mjcf": "model.data.folders:MjcfFolder",
        "procedural": "model.data.procedural.generate:ProceduralSet",
        "bundled": "model.data.folders:Bundled",
    },
    group="artiworld.datasets",
)
"""All data sets; a plug-in's callable takes the folder."""


def dataset_names() -> tuple[str, ...]:
    """Names that :func:`open_dataset` takes."""
    return DATASETS.names()


def open_dataset(options: DatasetOptions) -> Dataset:
    """The data set that is asked for.

    Raises:
        ConfigurationError: for an unknown name, or where a folder is needed.
        InputFileError: where the folder isn't there.
    """
    DATASETS.check(options.name)
    if options.name == "procedural" and options.root is None:
        return DATASETS.load(
            "procedural", options.seed, options.n, options.families, fault=options.fault
        )
    if options.name == "bundled" and options.root is None:
        return DATASETS.load("bundled")
    if options.name == "procedural":
        return DATASETS.load("partnet-mobility", _folder(options), name="procedural")
    return DATASETS.load(options.name, _folder(options))


def recognised(root: Path) -> Dataset:
    """The PartNet-Mobility or PhysXNet folder at ``root``, by its content.

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
