"""From samples to the loss: augmentation, teacher forcing, batches.

If several answers are correct (children in any order, candidates with the same motion), the loss
is the negative logarithm of their total probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor
from torch.nn import functional

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import LINE_REACH
from model.prediction.arti4urdf.network import ArtiModel, Prompt
from model.prediction.arti4urdf.structure import FIRST_FEATURE, FIRST_NAME_SCALAR, StructureArrays
from model.prediction.arti4urdf.vocabulary import FREE, Choice, Grammar, Token
from model.prediction.geometric.shape import rotation
from model.training.arti4urdf.samples import Labels, Sample

Bools = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Augmentation:
    """Augmentation of samples.

    Attributes:
        turns: quarter turns and reflections. shuffle: order and codes of the parts.
        nameless: share of samples whose names and category are hidden.
        plain: share of samples without the judgements of the geometric rules, so that the network
            learns from shapes.
        jitter: relative standard deviation of the numbers.
    """

    turns: bool = True
    shuffle: bool = True
    nameless: float = 0.25
    plain: float = 0.3
    jitter: float = 0.02


PLAIN = Augmentation(turns=False, shuffle=False, nameless=0.0, plain=0.0, jitter=0.0)


@dataclass(frozen=True, eq=False)
class Target:
    """One choice of the answer.

    Attributes:
        position: index of the token that answers it; the token before predicts it.
        choice: kind, part and allowed options. words, parts: correct options.
    """

    position: int
    choice: Choice
    words: Bools
    parts: Bools


@dataclass(frozen=True, eq=False)
class Example:
    """A prompt with its answer."""

    prompt: Prompt
    tokens: tuple[Token, ...]
    targets: tuple[Target, ...]
    types: npt.NDArray[np.int64]


def augmented(sample: Sample, how: Augmentation, rng: np.random.Generator) -> tuple[Prompt, Labels]:
    """A variant of a sample with its labels."""
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
    """The arrays without the mechanisms of the parts' names."""
    scalars = arrays.scalars.copy()
    scalars[:, FIRST_NAME_SCALAR:] = 0
    scalars[:, -1] = 1
    return replace(arrays, scalars=scalars)


def without_judgements(arrays: StructureArrays) -> StructureArrays:
    """The arrays without judgements of the rules: places, sizes and candidates remain."""
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
    m = rotation(np.array([0.0, 0.0, 1.0]), quarter * np.pi / 2)
    if mirrored:
        m = m @ np.diag([-1.0, 1.0, 1.0])
    axis = labels.axis @ m.T
    if mirrored:
        slides = labels.types == v.PRISMATIC
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
    """A prompt with an answer that is drawn among the correct ones."""
    scalars = prompt.arrays.candidate_scalars
    grammar = Grammar(scalars[..., 0] > 0, scalars[..., 6] > 0, json_step=json_step)
    tokens: list[Token] = []
    targets: list[Target] = []
    oracle = _Oracle(labels, grammar)
    while True:
        tokens += grammar.forced()
        choice = grammar.choice()
        if choice is None:
            break
        words, parts = oracle.correct(choice)
        words &= choice.words
        parts &= choice.parts
        options = [*np.flatnonzero(words), *(v.SIZE + np.flatnonzero(parts))]
        pick = int(options[int(rng.integers(len(options)))])
        targets.append(Target(len(tokens), choice, words, parts))
        if pick < v.SIZE:
            tokens.append(grammar.take(pick))
        else:
            tokens.append(grammar.take(-1, pick - v.SIZE))
    return Example(prompt, tuple(tokens), tuple(targets), labels.types)


class _Oracle:
    """The correct options of a choice."""

    def __init__(self, labels: Labels, grammar: Grammar) -> None:
        self.labels, self.grammar = labels, grammar

    def correct(self, choice: Choice) -> tuple[Bools, Bools]:
        """Masks over words and parts."""
        words, parts = np.zeros(v.SIZE, bool), np.zeros(len(choice.parts), bool)
        part = choice.part
        if choice.kind in ("root", "child"):
            parts = (self.labels.parents == part) & choice.parts
            words[v.ID["<close>"]] = not parts.any()
        elif choice.kind == "type":
            words[v.TYPE_IDS[self.labels.types[part]]] = True
        elif choice.kind == "slot":
            good = self.labels.offered[part] if self.labels.offered[part].any() else None
            good = self.labels.right[part] if good is None else good
            words[v.SLOT_IDS[good]] = True
            words &= choice.words
            if not words.any():
                words[v.ID["<free>"]] = True
        else:
            words[self._number(choice)] = True
        return words, parts

    def _number(self, choice: Choice) -> int:
        part, decision = choice.part, self.grammar.decisions[choice.part]
        if choice.kind == "number":
            k = len(decision.numbers)
            source = self.labels.axis if k < 3 else self.labels.line
            reach = 1.0 if k < 3 else LINE_REACH
            return int(v.NUMBER_IDS[v.coordinate_levels(source[part, k % 3], reach)])
        slot = decision.slot
        if choice.kind == "lower" and slot != FREE and self.labels.offered[part, slot]:
            return v.ID["<as_offered>"]
        low, high = self.labels.limits[part]
        if slot != FREE and not self.labels.same_sign[part, slot]:
            low, high = -high, -low
        revolute = v.TYPES[decision.type] == "revolute"
        levels = v.angle_levels if revolute else v.travel_levels
        value = levels(low) if choice.kind == "lower" else levels(high)
        return int(v.NUMBER_IDS[max(int(value), decision.lower)])


@dataclass(frozen=True, eq=False)
class Batch:
    """Examples side by side.

    Attributes:
        examples: as they are.
        words, parts: (B, T) tokens, padded. lengths: of each row.
        rows, places: (C,) where each choice is predicted.
        nodes: (C,) part whose child is chosen, -1 else.
        allowed, right: (C, SIZE + P) allowed and correct words, then parts.
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
        allowed[c, : v.SIZE], right[c, : v.SIZE] = t.choice.words, t.words
        end = v.SIZE + len(t.parts)
        allowed[c, v.SIZE : end], right[c, v.SIZE : end] = t.choice.parts, t.parts
    return Batch(
        tuple(examples),
        words,
        parts,
        lengths,
        np.array([b for b, _ in every]),
        np.array([t.position - 1 for _, t in every]),
        np.array([t.choice.part if t.choice.kind == "child" else -1 for _, t in every]),
        allowed,
        right,
        np.array([t.choice.kind for _, t in every]),
    )


TYPE_WEIGHT = 0.1
Z_WEIGHT = 1e-3
"""Weight of the squared log-sum-exp, which bounds the logits."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Loss of one batch.

    Attributes:
        total: scalar to minimise. losses: (C,) of each choice. hits: (C,) whether the likeliest
            option is correct. kinds: (C,).
    """

    total: Tensor
    losses: Tensor
    hits: Tensor
    kinds: np.ndarray


def batch_loss(model: ArtiModel, batch: Batch) -> Loss:
    """Negative log-likelihood of the correct answers, and an auxiliary loss of the joint types."""

    def here(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).to(model.device)

    encoded = model.encode([e.prompt for e in batch.examples])
    hidden = model(encoded, here(batch.words), here(batch.parts), lengths=batch.lengths)
    rows, places = here(batch.rows), here(batch.places)
    nodes = torch.full(hidden.shape[:2], -1, device=model.device)
    nodes[rows, places] = here(batch.nodes)
    pointed = model.point(encoded, hidden, nodes)[rows, places]
    words = model.word_logits(hidden[rows, places])
    logits = torch.cat([words, pointed], -1)
    allowed, right = here(batch.allowed), here(batch.right)
    logits = logits.float().masked_fill(~allowed, -1e9)
    whole = logits.logsumexp(-1)
    losses = whole - logits.masked_fill(~right, -1e9).logsumexp(-1)
    hits = right.gather(1, logits.argmax(-1, keepdim=True))[:, 0]
    total = (losses + Z_WEIGHT * whole.square()).sum() / len(batch.examples) / 8
    total = total + TYPE_WEIGHT * _type_loss(model, encoded.shapes, batch)
    return Loss(total, losses.detach().cpu(), hits.cpu(), batch.kinds)


def _type_loss(model: ArtiModel, shapes: Tensor, batch: Batch) -> Tensor:
    types = np.concatenate([e.types for e in batch.examples])
    return functional.cross_entropy(
        model.type_head(shapes), torch.from_numpy(types).to(model.device)
    )


def by_kind(kinds: np.ndarray, values: Tensor) -> dict[str, float]:
    """Mean value by kind of choice."""
    array = values.double().numpy()
    return {str(k): float(array[kinds == k].mean()) for k in np.unique(kinds)}
