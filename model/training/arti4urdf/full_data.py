"""Objects for the paper-size model: generated or read on demand, varied, written as text.

Draws depend on seed and position alone, not on processes or slices.
"""

from __future__ import annotations

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
from torch.utils.data import Dataset as TorchDataset

from model.core.articulated_object import ArticulatedObject, Part, SegmentedObject
from model.core.errors import ArtiworldError
from model.core.files import draft_of
from model.core.tree import KinematicTree
from model.data.registry import Dataset, GroundTruth
from model.prediction.arti4urdf.answer import rounded, write_answer
from model.prediction.arti4urdf.full_model import Example
from model.prediction.arti4urdf.full_predictor import make_example
from model.prediction.arti4urdf.text_script import as_written
from model.prediction.remote_backend import decode_request, encode_request
from model.training.arti4urdf.config import FullConfig
from model.training.arti4urdf.samples import MOST_PARTS, draw_truth, family_of

if TYPE_CHECKING:
    from tokenizers import Tokenizer

TRIES = 20
"""Unusable objects in a row after which a run ends."""
TOO_LONG = "too long"
INEXPRESSIBLE = "a compound motion that answers can't express"


@dataclass(frozen=True)
class ObjectSet:
    """All objects of a run, by number.

    Attributes:
        samples: number of procedural objects, which come first. seed, families: of them.
        listed: (data set, id) of the others.
        cache: folder for generated and read objects, or None.
    """

    samples: int
    seed: int
    families: tuple[str, ...]
    listed: tuple[tuple[Dataset, str], ...] = ()
    cache: Path | None = None

    def __len__(self) -> int:
        return self.samples + len(self.listed)

    def name(self, number: int) -> str:
        """Name of an object, unique among all runs."""
        if number < self.samples:
            return f"{family_of(self.families, number)}_{self.seed}_{number}"
        dataset, object_id = self.listed[number - self.samples]
        root = zlib.crc32(str(Path(getattr(dataset, "root", "")).resolve()).encode())
        return f"{dataset.name}_{root:08x}_{object_id}"

    def load(self, number: int) -> GroundTruth:
        """Generate or read one object; a damaged file of the cache is replaced.

        Raises:
            ArtiworldError: if its files are missing or damaged.
        """
        name = self.name(number)
        path = None if self.cache is None else self.cache / f"{name}.npz"
        if path is not None and path.is_file():
            try:
                return _unpacked(path.read_bytes())
            except (ArtiworldError, OSError):
                pass
        if number < self.samples:
            truth, _ = draw_truth(family_of(self.families, number), self.seed, number)
        else:
            dataset, object_id = self.listed[number - self.samples]
            truth = dataset.load(object_id)
        if path is not None:
            # A request with the true joints as locked ones.
            _write(path, encode_request(truth.segmented(), truth.object.tree.joints, 0))
        return truth


def _unpacked(data: bytes) -> GroundTruth:
    segmented, joints, _ = decode_request(data)
    links = dict.fromkeys(p.link for p in segmented.parts)
    links |= dict.fromkeys(link for j in joints for link in (j.parent, j.child))
    tree = KinematicTree(tuple(links), joints)
    obj = ArticulatedObject(segmented.name, segmented.parts, tree, segmented.category)
    return GroundTruth(segmented.name, obj)


def _write(path: Path, data: bytes) -> None:
    with draft_of(path) as draft:
        draft.write_bytes(data)


@dataclass(frozen=True, eq=False)
class Drawn:
    """The draw at one position.

    Attributes:
        example: with its answer; None after :data:`TRIES` unusable objects.
        position: in the order of the run.
        left_out: (object, reason) of the unusable ones.
    """

    example: Example | None
    position: int
    left_out: tuple[tuple[str, str], ...] = ()


class Draws(TorchDataset[Drawn]):
    """Position in the order of a run → example.

    Args:
        objects: to draw from. config: of their variations. tokenizer: for lengths.
        count: of positions.
    """

    def __init__(
        self, objects: ObjectSet, config: FullConfig, tokenizer: Tokenizer, count: int
    ) -> None:
        self.objects, self.config, self.tokenizer = objects, config, tokenizer
        self._count = count

    def __len__(self) -> int:
        return self._count

    def __getitem__(self, position: int) -> Drawn:
        left_out: list[tuple[str, str]] = []
        for attempt in range(TRIES):
            number = self._number(position, attempt)
            try:
                example, why = self._example(number, position)
            except ArtiworldError as error:
                example, why = None, str(error)
            except Exception as error:  # one bad object must not end the run
                example, why = None, f"{type(error).__name__}: {error}"
            if example is not None:
                return Drawn(example, position, tuple(left_out))
            left_out.append((self.objects.name(number), " ".join(why.split())[:300]))
        return Drawn(None, position, tuple(left_out))

    def _number(self, position: int, attempt: int) -> int:
        """Number of the object: each one once per epoch, or a substitute for an unusable one."""
        seed, count = self.config.seed, len(self.objects)
        if attempt:
            return int(np.random.default_rng([seed, position, attempt, 5]).integers(count))
        epoch, place = divmod(position, count)
        return int(_order(seed, epoch, count)[place])

    def _example(self, number: int, position: int) -> tuple[Example | None, str]:
        config = self.config
        truth = self.objects.load(number)
        parts = len(truth.object.parts)
        if not 2 <= parts <= MOST_PARTS:
            return None, f"{parts} parts, not 2 to {MOST_PARTS}"
        rng = np.random.default_rng([config.seed, position, 3])
        segmented, tree = varied(truth.object, config, rng)
        helpers = [x for x in tree.links if not x.startswith("link_")]
        if other := [x for x in helpers if not _is_screw(tree, x)]:
            return None, f"{INEXPRESSIBLE}: joints at {', '.join(other)}"
        example = make_example(
            segmented, config.points, structure=config.structure, seed=int(rng.integers(2**31))
        )
        answer = rounded(write_answer(tree, segmented))
        length = 1 + sum(
            len(self.tokenizer.encode(text, add_special_tokens=False).ids)
            for text in (example.prompt, answer)
        )
        if length > config.longest:
            return None, f"{TOO_LONG}: {length} tokens, more than {config.longest}"
        return replace(example, answer=answer), ""


def positions(batch: int, steps: range, process: int, processes: int) -> list[int]:
    """The positions that one of ``processes`` draws in ``steps`` of ``batch`` objects, in order."""
    return [step * batch + k for step in steps for k in range(process, batch, processes)]


@lru_cache(maxsize=2)
def _order(seed: int, epoch: int, count: int) -> npt.NDArray[np.int64]:
    return np.random.default_rng([seed, epoch, 6]).permutation(count)


def varied(
    obj: ArticulatedObject, config: FullConfig, rng: np.random.Generator
) -> tuple[SegmentedObject, KinematicTree]:
    """The parts in a random order, renumbered, some without names, and their true tree.

    Motions have the form of :func:`model.prediction.arti4urdf.text_script.as_written` and children
    are sorted by number, so that no name and no order has to be guessed.
    """
    order = [int(k) for k in rng.permutation(len(obj.parts))]
    nameless = rng.random() < config.nameless
    hidden = nameless | (rng.random(len(order) + 1) < config.forgotten)
    parts = tuple(
        replace(obj.parts[k], link=f"link_{i}", name=None if hidden[i] else obj.parts[k].name)
        for i, k in enumerate(order)
    )
    written = as_written(obj.tree, {p.link for p in obj.parts})
    tree = renumbered(written, [obj.parts[k] for k in order])
    category = None if hidden[-1] else obj.category
    return SegmentedObject("object", parts, category), tree


def renumbered(tree: KinematicTree, parts: Sequence[Part]) -> KinematicTree:
    """The tree with ``parts[i]`` as ``link_i``, and helpers and joints named after the parts."""
    number = {p.link: i for i, p in enumerate(parts)}
    below = {link: _first_part(tree, link, number) for link in tree.links}
    renamed: dict[str, str] = {}
    taken: set[str] = set()
    for link in reversed(tree.order):
        name = f"link_{number[link]}" if link in number else f"helper_{max(below[link], 0)}"
        while name in taken:  # a second helper above the same part
            name += "_above"
        renamed[link] = name
        taken.add(name)
    joints = tuple(
        replace(
            j, name=f"joint_{renamed[j.child]}", parent=renamed[j.parent], child=renamed[j.child]
        )
        for j in sorted(tree.joints, key=lambda j: below[j.child])
    )
    return KinematicTree(tuple(renamed[link] for link in tree.links), joints)


def _is_screw(tree: KinematicTree, helper: str) -> bool:
    """True if a helper has a prismatic joint and carries one part on a continuous joint."""
    first, below = tree.joint_of.get(helper), tree.children(helper)
    return (
        first is not None
        and first.slides
        and len(below) == 1
        and below[0].startswith("link_")
        and tree.joint_of[below[0]].type == "continuous"
    )


def _first_part(tree: KinematicTree, link: str, number: Mapping[str, int]) -> int:
    """The number of a part, or of the first part that a helper carries; -1 if it carries none."""
    if link in number:
        return number[link]
    below = (_first_part(tree, child, number) for child in tree.children(link))
    return min((n for n in below if n >= 0), default=-1)
