"""From samples to batches: augmentation, the answer to teach, and which choices are right.

Where several answers are right (children in any order, candidates that mean the same motion) all
of them count: the loss is the negative logarithm of their summed probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import LINE_REACH
from model.prediction.arti4urdf.grammar import FREE, Choice, Grammar, Token
from model.prediction.arti4urdf.network import Prompt
from model.prediction.arti4urdf.structure import FIRST_FEATURE, FIRST_NAME_SCALAR, StructureArrays
from model.training.arti4urdf.labels import Labels
from model.training.arti4urdf.samples import Sample

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Augmentation:
    """How samples are varied.

    Attributes:
        turns: quarter turns and reflections. shuffle: order and codes of the parts.
        nameless: share of samples whose names and category are hidden.
        plain: share of samples without the judgements of the geometric rules, so that the network
            learns to read shapes.
        jitter: standard deviation of the numbers, as a share of their size.
    """

    turns: bool = True
    shuffle: bool = True
    nameless: float = 0.25
    plain: float = 0.3
    jitter: float = 0.02


PLAIN = Augmentation(turns=False, shuffle=False, nameless=0.0, plain=0.0, jitter=0.0)


@dataclass(frozen=True, eq=False)
class Target:
    """One decision of the answer to teach.

    Attributes:
        position: index of the token that answers it; the token before predicts it.
        asked: kind, node and what is allowed.
        words, parts: which of the allowed are right.
    """

    position: int
    asked: Choice
    words: Bools
    parts: Bools


@dataclass(frozen=True, eq=False)
class Example:
    """A prompt with the answer to teach."""

    prompt: Prompt
    tokens: tuple[Token, ...]
    targets: tuple[Target, ...]
    types: npt.NDArray[np.int64]


def augmented(sample: Sample, how: Augmentation, rng: np.random.Generator) -> tuple[Prompt, Labels]:
    """A variant of a sample; labels follow."""
    arrays, labels, names = sample.arrays, sample.labels, sample.names
    category = sample.category
    if how.turns:
        quarter, mirrored = int(rng.integers(4)), bool(rng.random() < 0.5)
        arrays = arrays.turned(quarter, mirrored)
        labels = _turned(labels, quarter, mirrored)
    if how.shuffle:
        order = rng.permutation(len(arrays))
        arrays, labels = arrays.ordered(order), _ordered(labels, order)
        names = tuple(names[k] for k in order)
    if rng.random() < how.nameless:
        names, category = ("",) * len(names), ""
        arrays = without_names(arrays)
    if how.jitter:
        arrays = _jittered(arrays, how.jitter, rng)
    if rng.random() < how.plain:
        arrays = without_judgements(arrays)
    codes = rng.permutation(256)[: len(arrays)] if how.shuffle else np.arange(len(arrays))
    ids = tuple(v.name_ids(n) for n in names)
    return Prompt(arrays, v.category_id(category), ids, codes), labels


def without_names(arrays: StructureArrays) -> StructureArrays:
    """Without what the parts' names say of their motion."""
    scalars = arrays.scalars.copy()
    scalars[:, FIRST_NAME_SCALAR:] = 0
    scalars[:, -1] = 1
    return replace(arrays, scalars=scalars)


def without_judgements(arrays: StructureArrays) -> StructureArrays:
    """Without what the geometric rules think: only places, sizes and candidate motions remain."""
    scalars, candidates = arrays.scalars.copy(), arrays.candidate_scalars.copy()
    scalars[:, FIRST_FEATURE:] = 0
    candidates[..., 1:3] = 0
    return replace(arrays, scalars=scalars, candidate_scalars=candidates)


def _jittered(arrays: StructureArrays, amount: float, rng: np.random.Generator) -> StructureArrays:
    def noisy(values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        factor = 1 + amount * rng.standard_normal(values.shape)
        return (values * factor).astype(np.float32)

    count = arrays.points.shape[1]
    points = arrays.points[:, rng.permutation(count)]
    return replace(
        arrays, points=points, scalars=noisy(arrays.scalars), vectors=noisy(arrays.vectors)
    )


def _turned(labels: Labels, quarter: int, mirrored: bool) -> Labels:
    from model.prediction.geometric.shape import rotation

    m = rotation(np.array([0.0, 0.0, 1.0]), quarter * np.pi / 2)
    if mirrored:
        m = m @ np.diag([-1.0, 1.0, 1.0])
    axis = labels.axis @ m.T
    if mirrored:
        slides = labels.types == v.TYPES.index("prismatic")
        axis = axis * np.where(slides, 1.0, -1.0)[:, None]
    return replace(
        labels, axis=axis.astype(np.float32), line=(labels.line @ m.T).astype(np.float32)
    )


def _ordered(labels: Labels, order: npt.NDArray[np.int64]) -> Labels:
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    parents = labels.parents[order]
    rest = {
        name: getattr(labels, name)[order]
        for name in ("types", "right", "offered", "limits", "axis", "line", "same_sign")
    }
    return Labels(parents=np.where(parents >= 0, place[parents], -1), **rest)


def teacher_forced(
    prompt: Prompt, labels: Labels, rng: np.random.Generator, *, json_step: bool = True
) -> Example:
    """The answer to teach, drawn among those that are right."""
    scalars = prompt.arrays.candidate_scalars
    grammar = Grammar(scalars[..., 0] > 0, scalars[..., 6] > 0, json_step=json_step)
    tokens: list[Token] = []
    targets: list[Target] = []
    teacher = _Oracle(labels, grammar)
    while True:
        tokens += grammar.forced()
        asked = grammar.choice()
        if asked is None:
            break
        words, parts = teacher.right(asked)
        words &= asked.words
        parts &= asked.parts
        if not words.any() and not parts.any():
            words, parts = asked.words, asked.parts  # never: every truth can be said
        options = [*np.flatnonzero(words), *(v.SIZE + np.flatnonzero(parts))]
        pick = int(options[int(rng.integers(len(options)))])
        targets.append(Target(len(tokens), asked, words, parts))
        if pick < v.SIZE:
            tokens.append(grammar.take(pick))
        else:
            tokens.append(grammar.take(-1, pick - v.SIZE))
    return Example(prompt, tuple(tokens), tuple(targets), labels.types)


class _Oracle:
    """Which answers to a choice are right."""

    def __init__(self, labels: Labels, grammar: Grammar) -> None:
        self.labels, self.grammar = labels, grammar

    def right(self, asked: Choice) -> tuple[Bools, Bools]:
        """Masks over words and parts."""
        words, parts = np.zeros(v.SIZE, bool), np.zeros(len(asked.parts), bool)
        part = asked.part
        if asked.kind in ("root", "child"):
            parts = (self.labels.parents == part) & asked.parts
            words[v.ID["<close>"]] = not parts.any()
        elif asked.kind == "type":
            words[v.TYPE_IDS[self.labels.types[part]]] = True
        elif asked.kind == "slot":
            good = self.labels.offered[part] if self.labels.offered[part].any() else None
            good = self.labels.right[part] if good is None else good
            words[v.SLOT_IDS[good]] = True
            words &= asked.words
            if not words.any():
                words[v.ID["<free>"]] = True
        else:
            words[self._number(asked)] = True
        return words, parts

    def _number(self, asked: Choice) -> int:
        part, decision = asked.part, self.grammar.decisions[asked.part]
        if asked.kind == "number":
            k = len(decision.numbers)
            source = self.labels.axis if k < 3 else self.labels.line
            reach = 1.0 if k < 3 else LINE_REACH
            return int(v.NUMBER_IDS[v.coordinate_levels(source[part, k % 3], reach)])
        slot = decision.slot
        if asked.kind == "lower" and slot != FREE and self.labels.offered[part, slot]:
            return v.ID["<as_offered>"]
        low, high = self.labels.limits[part]
        if slot != FREE and not self.labels.same_sign[part, slot]:
            low, high = -high, -low
        revolute = v.TYPES[decision.type] == "revolute"
        levels = v.angle_levels if revolute else v.travel_levels
        value = levels(low) if asked.kind == "lower" else levels(high)
        return int(v.NUMBER_IDS[max(int(value), decision.lower)])


@dataclass(frozen=True, eq=False)
class Batch:
    """Examples side by side.

    Attributes:
        examples: as they are.
        words, parts: (B, T) tokens, padded. lengths: of each row.
        rows, places: (C,) where each decision is predicted.
        nodes: (C,) part whose child is asked for, -1 else.
        allowed, right: (C, SIZE + P) words, then parts.
        kinds: (C,).
    """

    examples: tuple[Example, ...]
    words: npt.NDArray[np.int64]
    parts: npt.NDArray[np.int64]
    lengths: tuple[int, ...]
    rows: npt.NDArray[np.int64]
    places: npt.NDArray[np.int64]
    nodes: npt.NDArray[np.int64]
    allowed: Bools
    right: Bools
    kinds: npt.NDArray[np.str_]


def collate(examples: Sequence[Example]) -> Batch:
    """Put examples side by side."""
    lengths = tuple(len(e.tokens) for e in examples)
    words = np.zeros((len(examples), max(lengths)), np.int64)
    parts = np.full_like(words, -1)
    most = max(len(e.prompt.arrays) for e in examples)
    for b, e in enumerate(examples):
        words[b, : lengths[b]] = [f.word for f in e.tokens]
        parts[b, : lengths[b]] = [f.part for f in e.tokens]
    every = [(b, t) for b, e in enumerate(examples) for t in e.targets]
    allowed = np.zeros((len(every), v.SIZE + most), bool)
    right = np.zeros_like(allowed)
    for c, (_, t) in enumerate(every):
        allowed[c, : v.SIZE], right[c, : v.SIZE] = t.asked.words, t.words
        end = v.SIZE + len(t.parts)
        allowed[c, v.SIZE : end], right[c, v.SIZE : end] = t.asked.parts, t.parts
    return Batch(
        tuple(examples),
        words,
        parts,
        lengths,
        np.array([b for b, _ in every]),
        np.array([t.position - 1 for _, t in every]),
        np.array([t.asked.part if t.asked.kind == "child" else -1 for _, t in every]),
        allowed,
        right,
        np.array([t.asked.kind for _, t in every]),
    )
