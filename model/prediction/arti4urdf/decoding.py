"""Constrained decoding: forced tokens are read in one pass, and only choices are made.

Probabilities are renormalised over what the grammar allows. Candidates with the same motion share
their probability, so that a hinge isn't outvoted because three mechanisms propose it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch
from scipy.special import softmax
from torch import Tensor

from model.core.progress import chosen_by_person
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.network import ArtiModel, Encoded, Prompt, token_tensors
from model.prediction.arti4urdf.structure import CANDIDATE_SCALARS, SLOTS
from model.prediction.arti4urdf.vocabulary import Choice, Decision, Grammar, Lock, Token

Array = npt.NDArray[np.float64]

SAME_AXIS = 0.998
"""Cosine above which the axes of two candidates are the same."""
SAME_LINE = 0.02
"""Distance (diagonals) below which their lines are the same."""


@dataclass(frozen=True, eq=False)
class ChoiceRecord:
    """A choice and its answer.

    Attributes:
        kind, part: of the choice. word, pointed: the answer, -1 for the other of the two.
        probability: of the answer, or of all candidates with its motion.
        words: (SIZE,) probability of every word. parts: (P,) of every part.
        plain: (SIZE,) log-odds of the words by the network alone, -inf if not allowed.
    """

    kind: str
    part: int
    word: int
    pointed: int
    probability: float
    words: Array
    parts: Array
    plain: Array


@dataclass(frozen=True, eq=False)
class Answer:
    """A complete answer.

    Attributes:
        decisions: by part. root: index of the base. records: the choices in order.
        tokens: all of the answer. passes: forward passes of the decoder.
        motions: part → (K,) its candidates, and the log-odds of each by the motion ranker.
    """

    decisions: tuple[Decision, ...]
    root: int
    records: tuple[ChoiceRecord, ...]
    tokens: tuple[Token, ...]
    passes: int
    motions: Mapping[int, tuple[npt.NDArray[np.int64], npt.NDArray[np.float32]]] = field(
        default_factory=dict
    )

    def record(self, part: int, kind: str) -> ChoiceRecord | None:
        """The first choice of a kind about a part, or None."""
        return next((r for r in self.records if r.part == part and r.kind == kind), None)


def same_motion(prompt: Prompt) -> npt.NDArray[np.bool_]:
    """(P, SLOTS, SLOTS) which candidates of a part have the same motion."""
    scalars = prompt.arrays.candidate_scalars
    axis, arm = np.moveaxis(prompt.arrays.candidate_vectors.astype(np.float64), 2, 0)
    along = np.abs(np.einsum("pkd,pld->pkl", axis, axis)) > SAME_AXIS
    off = np.linalg.norm(arm[:, :, None] - arm[:, None], axis=-1) < SAME_LINE
    present = scalars[..., 0] > 0
    turning = scalars[..., CANDIDATE_SCALARS - 1] > 0
    kind = turning[:, :, None] == turning[:, None]
    both = present[:, :, None] & present[:, None]
    return (along & off & kind & both) | np.eye(SLOTS, dtype=bool)


@contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on one thread, unless the environment sets the number.

    The steps of the small network are so short that threads wait for each other longer than they
    compute, a hundred times longer on a busy machine.
    """
    before = torch.get_num_threads()
    if before == 1 or chosen_by_person(os.environ):
        yield
        return
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@dataclass(eq=False)
class _Decoding:
    """One answer in the making."""

    model: ArtiModel
    encoded: Encoded
    grammar: Grammar
    same: npt.NDArray[np.bool_]
    prior: Array | None
    span: bool
    records: list[ChoiceRecord] = field(default_factory=list)
    tokens: list[Token] = field(default_factory=list)
    passes: int = 0

    def __post_init__(self) -> None:
        capacity = self.encoded.prefix.shape[1] + 12 * self.grammar.count
        self.cache = self.model.decoder.new_cache(capacity=capacity)

    def read(self, tokens: list[Token]) -> Tensor:
        """Append tokens; the hidden state (1, 1, D) after the last one."""
        hidden = None
        for chunk in [tokens] if self.span or not self.cache.length else [[t] for t in tokens]:
            words, parts = token_tensors(chunk, self.model.device)
            hidden = self.model(self.encoded, words, parts, cache=self.cache)[:, -1:]
            self.passes += 1
        assert hidden is not None
        self.tokens += tokens
        return hidden

    def choose(self, choice: Choice, hidden: Tensor) -> Token:
        """Make a choice and record it."""
        model = self.model
        node = torch.tensor([[choice.part if choice.kind == "child" else -1]], device=model.device)
        words = model.word_logits(hidden)[0, 0]
        pointers = model.point(self.encoded, hidden, node)[0, 0]
        logits = torch.cat([words, pointers]).double().cpu().numpy()
        plain = np.where(choice.words, np.nan_to_num(logits[: v.SIZE], nan=-1e9), -np.inf)
        if self.prior is not None and choice.kind in ("type", "slot", "lower"):
            logits[: v.SIZE] += self.prior[choice.part]
        word, part, value, probability = _likeliest(choice, logits, self.same)
        words, parts = probability[: v.SIZE], probability[v.SIZE :]
        self.records.append(
            ChoiceRecord(choice.kind, choice.part, word, part, value, words, parts, plain)
        )
        return self.grammar.take(word, part)


@torch.inference_mode()
@one_thread()
def decode(
    model: ArtiModel,
    prompt: Prompt,
    *,
    locked: dict[int, Lock] | None = None,
    prior: Array | None = None,
    span: bool = True,
) -> Answer:
    """Answer one prompt with the likeliest choices.

    Args:
        model: in evaluation mode. prompt: of the object.
        locked: parts whose parent (and joint) is given.
        prior: (P, SIZE) added to the logits of joint types, candidates and limits.
        span: append forced tokens in one pass; False reads them one by one, as plain generation
            does (for the benchmark).
    """
    scalars = prompt.arrays.candidate_scalars
    present, rotates = scalars[..., 0] > 0, scalars[..., CANDIDATE_SCALARS - 1] > 0
    grammar = Grammar(present, rotates, locked, json_step=model.config.json_step)
    state = _Decoding(model, model.encode([prompt]), grammar, same_motion(prompt), prior, span)
    pending: list[Token] = []
    while True:
        pending += grammar.forced()
        choice = grammar.choice()
        if choice is None:
            break
        only = _only(choice)
        if only is not None:
            pending.append(grammar.take(*only))
        else:
            pending = [state.choose(choice, state.read(pending))]
    return Answer(
        tuple(grammar.decisions),
        grammar.root,
        tuple(state.records),
        (*state.tokens, *pending),
        state.passes,
    )


def _only(choice: Choice) -> tuple[int, int] | None:
    """Word and part of a choice with a single option, else None."""
    if int(choice.words.sum()) + int(choice.parts.sum()) != 1:
        return None
    if choice.parts.any():
        return -1, int(np.argmax(choice.parts))
    return int(np.argmax(choice.words)), -1


def _likeliest(
    choice: Choice, logits: Array, same: npt.NDArray[np.bool_]
) -> tuple[int, int, float, Array]:
    """Word and part (one is -1) of the likeliest option, its probability, and that of all."""
    allowed = np.concatenate([choice.words, choice.parts])
    logits = np.where(allowed, np.nan_to_num(logits, nan=-1e9), -np.inf)
    probability = softmax(logits)
    words, parts = probability[: v.SIZE], probability[v.SIZE :]
    score = probability.copy()
    if choice.kind == "slot":
        slots = words[v.SLOT_IDS]
        shared = same[choice.part] @ slots
        score[v.SLOT_IDS] = np.where(choice.words[v.SLOT_IDS], shared + 1e-6 * slots, 0)
    elif choice.kind == "child":
        # Children come in any order: their probability is shared by those still to come.
        close = v.ID["<close>"]
        if choice.words[close]:
            score[close] = 2.0 if words[close] > parts.sum() else -1.0
    pick = int(np.argmax(score))
    value = float(np.clip(score[pick], 0, 1)) if choice.kind == "slot" else float(probability[pick])
    word, part = (pick, -1) if pick < v.SIZE else (-1, pick - v.SIZE)
    return word, part, value, probability
