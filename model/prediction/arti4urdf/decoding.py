"""Constrained decoding: forced spans in one forward pass, only real choices are made.

Probabilities are renormalised over what the grammar allows. Candidates that mean the same motion
share their probability, so that a hinge is not outvoted because three mechanisms propose it.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
import torch

from model.core.threads import chosen_by_person
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.grammar import Choice, Decision, Feed, Grammar, Lock
from model.prediction.arti4urdf.network import ArtiModel, Prompt, feeds_to_tensors
from model.prediction.arti4urdf.structure import CANDIDATE_SCALARS, SLOTS

Array = npt.NDArray[np.float64]

SAME_AXIS = 0.998
SAME_LINE = 0.02
"""Candidates whose axes and lines (diagonals) are nearer than this mean the same motion."""


@dataclass(frozen=True, eq=False)
class Made:
    """One choice as it was made.

    Attributes:
        kind, part: what was asked. word, pointed: the answer, -1 for the other of the two.
        probability: of the answer (of all that mean the same). words: (SIZE,) of every word.
        parts: (P,) of every part.
        plain: (SIZE,) log-odds of every word by the network alone, -inf where it isn't allowed.
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
        decisions: by part. root: index of the base. made: the choices in order.
        feeds: all tokens. passes: forward passes of the decoder.
        log_likelihood: sum over the choices.
    """

    decisions: tuple[Decision, ...]
    root: int
    made: tuple[Made, ...]
    feeds: tuple[Feed, ...]
    passes: int
    log_likelihood: float

    def choices(self, part: int, kind: str) -> list[Made]:
        """Choices of a kind that were made about a part."""
        return [m for m in self.made if m.part == part and m.kind == kind]


@dataclass(eq=False)
class _Tape:
    """What has been said so far."""

    grammar: Grammar
    same: npt.NDArray[np.bool_]
    made: list[Made] = field(default_factory=list)
    feeds: list[Feed] = field(default_factory=list)
    passes: int = 0


def same_motion(prompt: Prompt) -> npt.NDArray[np.bool_]:
    """(P, SLOTS, SLOTS) which candidates of a part mean the same motion."""
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
    """torch on one thread, unless the environment says how many.

    The small network's steps are so short that several threads wait for each other longer than
    they work: a hundred times as long where other programs want the processors, too.
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


@torch.inference_mode()
@one_thread()
def decode(
    model: ArtiModel,
    prompt: Prompt,
    *,
    locked: dict[int, Lock] | None = None,
    prior: Array | None = None,
    span: bool = True,
    rng: np.random.Generator | None = None,
) -> Answer:
    """Answer one prompt.

    Args:
        model: in evaluation mode.
        prompt: of the object.
        locked: parts whose parent (and joint) is settled: forced spans.
        prior: (P, SIZE) added to the logits of joint types, candidates and limits.
        span: append forced tokens in one pass; False reads them one by one, as plain generation
            does (for the benchmark).
        rng: sample instead of taking the likeliest.
    """
    scalars = prompt.arrays.candidate_scalars
    present, rotates = scalars[..., 0] > 0, scalars[..., CANDIDATE_SCALARS - 1] > 0
    grammar = Grammar(present, rotates, locked, json_step=model.config.json_step)
    tape = _Tape(grammar, same_motion(prompt))
    encoded = model.encode([prompt])
    cache = model.decoder.new_cache(capacity=encoded.prefix.shape[1] + 12 * len(prompt.arrays))
    pending: list[Feed] = []
    while True:
        pending += grammar.forced()
        asked = grammar.choice()
        if asked is None:
            break
        only = _only(asked)
        if only is not None:
            pending.append(grammar.take(*only))
            continue
        hidden = None
        for chunk in [pending] if span or not cache.length else [[f] for f in pending]:
            words, parts = feeds_to_tensors(chunk, model.device)
            hidden = model(encoded, words, parts, cache=cache)[:, -1:]
            tape.passes += 1
        assert hidden is not None
        tape.feeds += pending
        node = asked.part if asked.kind == "child" else -1
        logits = torch.cat(
            [
                model.word_logits(hidden)[0, 0],
                model.point(encoded, hidden, torch.tensor([[node]], device=model.device))[0, 0],
            ]
        )
        values = logits.double().cpu().numpy()
        plain = np.where(asked.words, np.nan_to_num(values[: v.SIZE], nan=-1e9), -np.inf)
        if prior is not None and asked.kind in ("type", "slot", "lower"):
            values[: v.SIZE] += prior[asked.part]
        pending = [_make(tape, asked, values, plain, rng)]
    tape.feeds += pending
    total = float(sum(np.log(max(m.probability, 1e-12)) for m in tape.made))
    return Answer(
        tuple(grammar.decisions),
        grammar.root,
        tuple(tape.made),
        tuple(tape.feeds),
        tape.passes,
        total,
    )


def _only(asked: Choice) -> tuple[int, int] | None:
    """The answer where there is just one."""
    if int(asked.words.sum()) + int(asked.parts.sum()) != 1:
        return None
    if asked.parts.any():
        return -1, int(np.argmax(asked.parts))
    return int(np.argmax(asked.words)), -1


def _make(
    tape: _Tape, asked: Choice, logits: Array, plain: Array, rng: np.random.Generator | None
) -> Feed:
    """Make one choice and record it."""
    allowed = np.concatenate([asked.words, asked.parts])
    logits = np.where(allowed, np.nan_to_num(logits, nan=-1e9), -np.inf)
    weights = np.exp(logits - logits[allowed].max())
    probability = weights / weights.sum()
    words, parts = probability[: v.SIZE], probability[v.SIZE :]
    score = probability
    if asked.kind == "slot":
        words = words.copy()
        shared = tape.same[asked.part] @ words[v.SLOT_IDS]
        score = probability.copy()
        score[v.SLOT_IDS] = np.where(asked.words[v.SLOT_IDS], shared + 1e-6 * words[v.SLOT_IDS], 0)
    elif asked.kind == "child":
        # Children come in any order: their probability is shared among those still to come.
        score = probability.copy()
        close = v.ID["<close>"]
        if asked.words[close]:
            score[close] = 2.0 if words[close] > parts.sum() else -1.0
    pick = int(np.argmax(score)) if rng is None else int(rng.choice(len(score), p=probability))
    word, part = (pick, -1) if pick < v.SIZE else (-1, pick - v.SIZE)
    value = float(np.clip(score[pick], 0, 1)) if asked.kind == "slot" else float(probability[pick])
    tape.made.append(Made(asked.kind, asked.part, word, part, value, words, parts, plain))
    return tape.grammar.take(word, part)
