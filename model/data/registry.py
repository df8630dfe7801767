"""The port that every data set fits, with its splits, and all data sets in one table."""

from __future__ import annotations

import re
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, runtime_checkable

from model.core.articulated_object import ArticulatedObject, Part, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError, InputFileError
from model.core.packages import Registry


@dataclass(frozen=True, eq=False)
class GroundTruth:
    """One object with its true kinematic tree, in the world frame (metres, +z up) at q = 0.

    Attributes:
        id: the object's name within its data set.
        object: parts (already merged to those that move on their own), tree, category. Links
            without geometry are helpers and don't begin with ``link_``.
        notes: human-readable remarks on changes made on reading.
    """

    id: str
    object: ArticulatedObject
    notes: tuple[str, ...] = ()

    def segmented(self, *, names: bool = True) -> SegmentedObject:
        """The predictor's input: the parts in their rest pose, without the tree.

        Args:
            names: whether part names and the category come along.
        """
        parts = self.object.parts
        if not names:
            parts = tuple(Part(p.link, p.mesh, p.cloud) for p in parts)
        return SegmentedObject(self.id, parts, self.object.category if names else None)


@runtime_checkable
class Dataset(Protocol):
    """A folder or generator of ground-truth objects."""

    @property
    def name(self) -> str:
        """Name of the data set, as on the command line."""
        ...

    def category(self, object_id: str) -> str | None:
        """The category of an object, read without its geometry; None if unknown."""
        ...

    def ids(self) -> tuple[str, ...]:
        """Names of all objects, sorted."""
        ...

    def load(self, object_id: str) -> GroundTruth:
        """Read one object.

        Raises:
            ArtiworldError: where its files are missing or broken, naming the file.
        """
        ...


HELD_OUT = ("display", "suitcase", "plier", "kettle", "oven")
"""The categories that the paper never trains on (*ArtiWorld*, section on data)."""
TEST_SHARE = 0.2
"""Share of the test part where no share is given."""
FORMS = "all, held-out, known, train[:SHARE], test[:SHARE] or category:NAME,NAME"


def select(dataset: Dataset, split: str, *, seed: int = 0) -> tuple[str, ...]:
    """The ids of ``dataset`` that belong to ``split``, in their order.

    Args:
        dataset: asked for ids and, where the split needs it, categories.
        split: ``all``; ``held-out`` (the paper's five categories); ``known`` (all others);
            ``test`` or ``train``, with the test's share as in ``test:0.1``; ``category:Oven,Door``.
        seed: random seed of ``train`` and ``test``.

    Raises:
        ConfigurationError: for another word, or where nothing is left.
    """
    word, _, rest = split.strip().partition(":")
    ids = dataset.ids()
    if word == "all":
        kept: Sequence[str] = ids
    elif word in ("held-out", "known"):
        kept = [i for i in ids if is_held_out(dataset.category(i)) == (word == "held-out")]
    elif word in ("train", "test"):
        share = _share(split, rest)
        kept = [i for i in ids if in_test(i, seed, share) == (word == "test")]
    elif word == "category" and rest:
        wanted = {_plain(c) for c in rest.split(",")}
        kept = [i for i in ids if _plain(dataset.category(i) or "") in wanted]
    else:
        raise ConfigurationError(f"no split {split!r}; write {FORMS}")
    if not kept:
        there = ", ".join(sorted({dataset.category(i) or "unknown" for i in ids})[:40])
        raise ConfigurationError(f"the split {split!r} leaves no object; categories: {there}")
    return tuple(kept)


def training_ids(
    dataset: Dataset, *, held_out: bool = False, test_share: float = 0.0
) -> tuple[str, ...]:
    """The training ids of ``dataset``; an object with an unreadable category stays.

    Args:
        dataset: asked for ids and categories.
        held_out: keep the paper's five held-out categories.
        test_share: leave out what the split ``test:<share>`` holds.
    """
    ids = [i for i in dataset.ids() if not (test_share and in_test(i, 0, test_share))]
    return tuple(i for i in ids if held_out or not is_held_out(_category(dataset, i)))


def _category(dataset: Dataset, object_id: str) -> str | None:
    try:
        return dataset.category(object_id)
    except ArtiworldError:
        return None


def is_held_out(category: str | None) -> bool:
    """True if the paper holds this category out; case and plural don't matter."""
    return _plain(category or "") in {_plain(c) for c in HELD_OUT}


def in_test(object_id: str, seed: int, share: float = TEST_SHARE) -> bool:
    """True if an object belongs to the test part of a split by ``seed``."""
    return zlib.crc32(f"{seed}:{object_id}".encode()) / 2**32 < share


def _plain(category: str) -> str:
    return re.sub(r"[^a-z0-9]", "", category.lower()).removesuffix("s")


def _share(split: str, text: str) -> float:
    try:
        share = float(text) if text else TEST_SHARE
    except ValueError:
        share = -1.0
    if not 0.0 < share < 1.0:
        raise ConfigurationError(f"the share of {split!r} must be between 0 and 1, as in test:0.1")
    return share


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
