"""Training samples: procedural objects, corrupted, with their structure prompts and labels."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import as_completed
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.progress import Progress, no_progress
from model.data.procedural.corruption import MIXED, corrupted, sometimes
from model.data.procedural.generate import COMPOSITE, family_names, make
from model.data.protocol import GroundTruth
from model.data.registry import recognised
from model.data.splits import training_ids
from model.evaluation.pool import in_processes
from model.prediction.arti4urdf.structure import StructureArrays, read_structure, structure_arrays
from model.training.arti4urdf.labels import Labels, label

HELD_OUT = ("Display", "Suitcase", "Pliers", "Kettle", "Oven")
"""The paper's five categories that are never trained on."""
VERSION = 1
BUDGET = 12000
MOST_PARTS = 40


@dataclass(frozen=True, eq=False)
class Sample:
    """One object as the network sees it, with its labels.

    Attributes:
        id: family, seed and index.
        category, names: "" where they are not given.
    """

    id: str
    category: str
    names: tuple[str, ...]
    arrays: StructureArrays
    labels: Labels


def training_families() -> tuple[str, ...]:
    """All families but those held out; composites are drawn more often."""
    return tuple(f for f in family_names() if f not in HELD_OUT)


def family_of(families: Sequence[str], index: int) -> str:
    """What the object with this index is: composites every fourth, the families in turn."""
    return COMPOSITE if index % 4 == 3 else families[index % len(families)]


def draw_truth(family: str, seed: int, index: int) -> tuple[GroundTruth, bool]:
    """A procedural object, one time in three clean, else corrupted, and whether it has names."""
    rng = np.random.default_rng([seed, index, 7])
    made = make(family, seed, index)
    named = bool(rng.random() < 0.5)
    if rng.random() < 0.35:
        return GroundTruth(f"{family}_{seed}_{index}", made.object), named
    settings = sometimes(MIXED, rng)
    return corrupted(made, settings, rng, name=f"{family}_{seed}_{index}"), named


def make_sample(truth: GroundTruth, *, named: bool, seed: int) -> Sample | None:
    """The structure prompt and labels of one object; None where it can't serve."""
    segmented = truth.segmented(names=named)
    if not 2 <= len(segmented.parts) <= MOST_PARTS:
        return None
    rng = np.random.default_rng(seed)
    structure = read_structure(segmented, seed, budget=BUDGET)
    labels = label(structure, truth.object)
    if labels is None:
        return None
    arrays = structure_arrays(structure, rng)
    names = tuple(s.name or "" for s in structure.sampled.shapes)
    return Sample(truth.id, segmented.category or "", names, arrays, labels)


def generate_samples(
    families: Sequence[str], seed: int, indices: Sequence[int]
) -> Iterator[Sample | None]:
    """Samples one by one; None for a failure."""
    for index in indices:
        truth, named = draw_truth(family_of(families, index), seed, index)
        yield make_sample(truth, named=named, seed=index)


_ARRAYS = tuple(f.name for f in fields(StructureArrays))
_LABELS = tuple(f.name for f in fields(Labels))


def write_shard(samples: Sequence[Sample], path: Path) -> None:
    """Write samples as one file; it appears whole or not at all."""
    out: dict[str, npt.NDArray[np.generic]] = {
        "version": np.array(VERSION),
        "sizes": np.array([len(s.arrays) for s in samples]),
        "ids": np.array([s.id for s in samples]),
        "categories": np.array([s.category for s in samples]),
        "names": np.array(["|".join(s.names) for s in samples]),
    }
    for name in _ARRAYS:
        values = [getattr(s.arrays, name) for s in samples]
        if name == "relations":
            values = [v.reshape(-1, v.shape[-1]) for v in values]
        out[f"arrays.{name}"] = _compact(np.concatenate(values))
    for name in _LABELS:
        out[f"labels.{name}"] = np.concatenate([getattr(s.labels, name) for s in samples])
    part = path.with_suffix(".part")
    with part.open("wb") as stream:
        np.savez(stream, **out)  # type: ignore[arg-type]
    part.replace(path)


def _compact(values: npt.NDArray[np.generic]) -> npt.NDArray[np.generic]:
    return values.astype(np.float16) if values.dtype == np.float32 else values


def read_shard(path: Path) -> list[Sample]:
    """Read what :func:`write_shard` wrote.

    Raises:
        ConfigurationError: where the file is of another version.
    """
    with np.load(path, allow_pickle=False) as data:
        if int(data["version"]) != VERSION:
            raise ConfigurationError(
                f"{path} has version {int(data['version'])}, this is {VERSION}: make it again"
            )
        columns = {k: data[k] for k in data.files}
    ends = np.cumsum(columns["sizes"])
    squares = np.cumsum(columns["sizes"] ** 2)
    out: list[Sample] = []
    for k, size in enumerate(columns["sizes"]):
        rows = slice(ends[k] - size, ends[k])
        values = {}
        for name in _ARRAYS:
            whole = columns[f"arrays.{name}"]
            if name == "relations":
                cut = whole[squares[k] - size**2 : squares[k]].reshape(size, size, -1)
            else:
                cut = whole[rows]
            if cut.dtype == np.float16:
                cut = np.nan_to_num(cut.astype(np.float32), posinf=8, neginf=-8).clip(-8, 8)
            values[name] = cut
        labels = Labels(**{name: columns[f"labels.{name}"][rows] for name in _LABELS})
        out.append(
            Sample(
                str(columns["ids"][k]),
                str(columns["categories"][k]),
                tuple(str(columns["names"][k]).split("|")),
                StructureArrays(**values),
                labels,
            )
        )
    return out


def write_shards(
    folder: Path,
    count: int,
    *,
    seed: int = 0,
    shard: int = 100,
    families: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> int:
    """Fill ``folder`` with shards of ``shard`` objects; those that are there are kept.

    Returns:
        Objects written now.
    """
    folder.mkdir(parents=True, exist_ok=True)
    written = 0
    for first in range(math.ceil(count / shard)):
        written += _write_one(folder, count, seed, shard, families, first)
        progress((first + 1) * shard / count, f"{written} objects")
    return written


def make_shards(
    folder: Path,
    count: int,
    *,
    seed: int,
    shard: int = 100,
    jobs: int = 1,
    families: Sequence[str] | None = None,
    progress: Progress = no_progress,
) -> None:
    """:func:`write_shards` in ``jobs`` processes (0: one a core)."""
    jobs = jobs or os.cpu_count() or 1
    missing = sum(
        not (folder / f"{seed:04d}_{k:05d}.npz").exists() for k in range(math.ceil(count / shard))
    )
    if jobs == 1 or missing <= 1:
        write_shards(folder, count, seed=seed, shard=shard, families=families, progress=progress)
        return
    folder.mkdir(parents=True, exist_ok=True)
    firsts = range(math.ceil(count / shard))
    write = partial(_write_one, folder, count, seed, shard, families)
    with in_processes(write, firsts, min(jobs, missing), "spawn") as waiting:
        for done, job in enumerate(as_completed(waiting)):
            job.result()
            progress((done + 1) / len(waiting), f"{(done + 1) * shard} objects")


def _write_one(
    folder: Path, count: int, seed: int, shard: int, families: Sequence[str] | None, number: int
) -> int:
    path = folder / f"{seed:04d}_{number:05d}.npz"
    if path.exists():
        return 0
    indices = range(number * shard, min(count, (number + 1) * shard))
    found = generate_samples(families or training_families(), seed, indices)
    kept = [s for s in found if s is not None]
    if kept:
        write_shard(kept, path)
    return len(kept)


def write_dataset(
    root: Path,
    folder: Path,
    *,
    held_out: bool = False,
    test_share: float = 0.0,
    progress: Progress = no_progress,
) -> tuple[int, list[str]]:
    """Add a shard of the objects under ``root``, each with and without names.

    Args:
        root: of PartNet-Mobility or PhysXNet. folder: of the shards.
        held_out, test_share: see :func:`model.data.splits.training_ids`.
        progress: told each object.

    Returns:
        Samples written, and what couldn't be read and why.

    Raises:
        InputFileError: where ``root`` is no such folder.
    """
    dataset = recognised(root)
    ids = training_ids(dataset, held_out=held_out, test_share=test_share)
    kept: list[Sample] = []
    bad: list[str] = []
    for k, object_id in enumerate(ids):
        progress(k / len(ids), object_id)
        try:
            truth = dataset.load(object_id)
            made = [make_sample(truth, named=named, seed=k) for named in (True, False)]
        except ArtiworldError as error:
            bad.append(str(error))
            continue
        kept += [s for s in made if s is not None]
    if kept:
        folder.mkdir(parents=True, exist_ok=True)
        write_shard(kept, folder / f"data_{root.resolve().name}.npz")
    return len(kept), bad
