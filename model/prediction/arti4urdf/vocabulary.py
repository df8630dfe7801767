"""The compact vocabulary of the answer, and its grammar: which words and parts may come next.

Structural strings, joint types, candidates and numbers are single tokens. Parts are no words but
are pointed at, so that an object can have any number of them.

The answer is the paper's reasoning chain: ``<json_start>``, the tree from the base down (a part,
its joint type, its children), ``<json_end>``, then ``<urdf_start>``, the candidate joint and the
limits of each moving part, ``<urdf_end>``. Tokens without an alternative are forced and need no
forward pass of their own. Every sequence of choices parses: one root, no cycle, every part once,
limits in order.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.core.names import category_key, known_word, words
from model.prediction.arti4urdf.structure import MECHANISMS, RANKS, SLOTS

TYPES = ("revolute", "continuous", "prismatic", "screw", "fixed")
REVOLUTE, CONTINUOUS, PRISMATIC, SCREW, FIXED = range(len(TYPES))
"""``screw`` stands for two joints along one axis, prismatic and continuous, with a helper link."""

_STRUCTURAL = (
    *"<pad> <bos> <g_start> <g_end> <p_start> <p_end> <json_start> <close> <json_end>".split(),
    *"<urdf_start> <links> <free> <as_offered> <urdf_end> <child> <joint> <unknown>".split(),
)
STEPS = 20
"""Numbers have 2 * STEPS + 1 levels."""

# Weights refer to words by index: never change the order, append new ones.
CATEGORIES = tuple(
    """bottle box bucket camera cart chair clock coffeemachine dishwasher dispenser display door
    eyeglasses fan faucet foldingchair globe kettle keyboard kitchenpot knife lamp laptop lighter
    microwave mouse oven pen phone pliers printer refrigerator remote safe scissors stapler
    storagefurniture suitcase switch table toaster toilet trashcan usb washingmachine
    window""".split()
)
NAME_WORDS = tuple(
    """arm backrest bail ball basket blade bolt bracket bulb button cap cartridge caster circle
    container cork cover crank crown dial display door drawer drum fan faucet flap footrest gate
    gear globe hand handle hatch head jaw key knob lamp latch leg lens lever lid lock monitor neck
    nozzle pad pedal plate plug plunger propeller pump rack ring rocker roller rotor sash screen
    seat shade shaft shelf shutter slider sphere spout stopper switch tabletop tap temple toggle
    tool tray trigger turntable wheel window""".split()
)


def _tokens() -> tuple[str, ...]:
    out = list(_STRUCTURAL)
    out += [f"<{t}>" for t in TYPES]
    out += [f"<{m}.{r}>" for m in MECHANISMS for r in range(RANKS)]
    out += [f"<{i:+d}>" for i in range(-STEPS, STEPS + 1)]
    out += [f"<category {c}>" for c in CATEGORIES]
    out += [f"<name {w}>" for w in NAME_WORDS]
    return tuple(out)


TOKENS = _tokens()
ID = {t: i for i, t in enumerate(TOKENS)}
SIZE = len(TOKENS)

TYPE_IDS = np.array([ID[f"<{t}>"] for t in TYPES])
SLOT_IDS = np.array([ID[f"<{m}.{r}>"] for m in MECHANISMS for r in range(RANKS)])
NUMBER_IDS = np.array([ID[f"<{i:+d}>"] for i in range(-STEPS, STEPS + 1)])
assert len(SLOT_IDS) == SLOTS


def category_id(category: str | None) -> int:
    """Id of the category's token, or of ``<unknown>``."""
    return ID.get(f"<category {category_key(category)}>", ID["<unknown>"])


def name_ids(name: str | None) -> tuple[int, ...]:
    """Ids of the known words of a part's name, at most two, last ones first."""
    out: list[int] = []
    for word in reversed(words(name)):
        hit = known_word(word, NAME_WORDS)
        if hit is not None:
            out.append(ID[f"<name {hit}>"])
    return tuple(out[:2])


Levels = npt.NDArray[np.int64]


def angle_levels(values: npt.ArrayLike) -> Levels:
    """Radians in ±pi → level indices."""
    return _clipped(np.asarray(values, float) / math.pi * STEPS)


def level_angle(level: int) -> float:
    """Level index → radians."""
    return (level - STEPS) * math.pi / STEPS


def travel_levels(values: npt.ArrayLike) -> Levels:
    """Diagonals in ±1 → level indices, finer near zero."""
    v = np.asarray(values, float)
    return _clipped(np.sign(v) * np.sqrt(np.abs(v)) * STEPS)


def level_travel(level: int) -> float:
    """Level index → diagonals."""
    share = (level - STEPS) / STEPS
    return math.copysign(share * share, share)


def coordinate_levels(values: npt.ArrayLike, reach: float) -> Levels:
    """Numbers in ±reach → level indices."""
    return _clipped(np.asarray(values, float) / reach * STEPS)


def level_coordinate(level: int, reach: float) -> float:
    """Level index → number in ±reach."""
    return (level - STEPS) / STEPS * reach


def _clipped(values: npt.NDArray[np.float64]) -> Levels:
    return np.clip(np.rint(np.nan_to_num(values)), -STEPS, STEPS).astype(np.int64) + STEPS


Kind = Literal["root", "child", "type", "slot", "number", "lower", "upper"]
Bools = npt.NDArray[np.bool_]

FREE_NUMBERS = 6
"""An axis (3) and the point of its line nearest to the part's centre (3)."""
FREE = SLOTS
"""Slot for "no candidate fits"."""


@dataclass(frozen=True)
class Token:
    """One token to append: a word, and the part that it points at or -1."""

    word: int
    part: int = -1


@dataclass(frozen=True)
class Choice:
    """An open choice.

    Attributes:
        kind: of the choice.
        part: whose children ("child"), type, candidate or limits are chosen; -1 for the root.
        words: (SIZE,) allowed words. parts: (P,) parts that may be pointed at.
    """

    kind: Kind
    part: int
    words: Bools
    parts: Bools


@dataclass
class Decision:
    """The decisions about a part.

    Attributes:
        parent: index, -1 for the root. type: index into ``TYPES``.
        slot: candidate, FREE, or -1 for none.
        numbers: level indices of a free axis and line.
        lower, upper: level indices, or -1 for the candidate's own limits.
    """

    parent: int = -1
    type: int = TYPES.index("fixed")
    slot: int = -1
    numbers: list[int] = field(default_factory=list)
    lower: int = -1
    upper: int = -1


@dataclass(frozen=True)
class Lock:
    """A part with a given parent, and with a given joint unless the type is -1."""

    parent: int
    type: int = -1


class Grammar:
    """The state of one answer.

    Args:
        present: (P, SLOTS) which candidates exist. rotates: (P, SLOTS) which of them rotate.
        locked: by part.
        json_step: write the tree first, then the motions; False decides each part's motion with
            its place, without the reasoning chain (an ablation of the paper).
    """

    def __init__(
        self,
        present: Bools,
        rotates: Bools,
        locked: dict[int, Lock] | None = None,
        *,
        json_step: bool = True,
    ):
        self._present, self._rotates = present, rotates
        self.locked = dict(locked or {})
        self.count = len(present)
        self.decisions = [Decision() for _ in range(self.count)]
        self.root = -1
        self._placed = np.zeros(self.count, bool)
        self._stack: list[int] = []
        self._json_step = json_step
        self._pending = [Token(ID["<json_start>" if json_step else "<urdf_start>"])]
        self._queue: list[int] = []
        self._asks: Kind | None = "root"
        self._part = -1

    def forced(self) -> list[Token]:
        """Tokens to append before the next choice; each is returned once."""
        out, self._pending = self._pending, []
        return out

    def choice(self) -> Choice | None:
        """The next choice, or None when the answer is complete."""
        if self._asks is None:
            return None
        words, parts = np.zeros(SIZE, bool), np.zeros(self.count, bool)
        kind, part = self._asks, self._part
        if kind == "root":
            parts[:] = True
            parts[[k for k in self.locked if 0 <= k < self.count]] = False
            if not parts.any():
                parts[:] = True
        elif kind == "child":
            parts = self._possible(part)
            words[ID["<close>"]] = self._may_close(part)
        elif kind == "type":
            lock = self.locked.get(part)
            given = lock is not None and lock.type >= 0
            words[[TYPE_IDS[lock.type]] if lock is not None and given else TYPE_IDS] = True
        elif kind == "slot":
            turning = self.decisions[part].type != PRISMATIC
            words[SLOT_IDS[self._present[part] & (self._rotates[part] == turning)]] = True
            words[ID["<free>"]] = True
        elif kind == "number":
            words[NUMBER_IDS] = True
        elif kind == "lower":
            words[NUMBER_IDS] = True
            words[ID["<as_offered>"]] = self.decisions[part].slot != FREE
        else:
            words[NUMBER_IDS[self.decisions[part].lower :]] = True
        return Choice(kind, part, words, parts)

    def _possible(self, node: int) -> Bools:
        out = ~self._placed
        for k, lock in self.locked.items():
            if lock.parent != node:
                out[k] = False
        return out

    def _may_close(self, node: int) -> bool:
        mine = any(lock.parent == node and not self._placed[k] for k, lock in self.locked.items())
        return not mine and (len(self._stack) > 1 or bool(self._placed.all()))

    def take(self, word: int, part: int = -1) -> Token:
        """Choose a word, or a part for "root" and "child"; returns the token to append.

        Raises:
            ValueError: if it isn't allowed.
        """
        choice = self.choice()
        if choice is None:
            raise ValueError("the answer is complete")
        kind, at = choice.kind, choice.part
        pointed = 0 <= part < self.count and choice.parts[part]
        if not (pointed if part >= 0 else choice.words[word]):
            raise ValueError(f"{kind} of part {at} allows neither word {word} nor part {part}")
        if kind in ("root", "child"):
            return self._take_part(at, part)
        if kind == "type":
            self.decisions[at].type = int(np.flatnonzero(word == TYPE_IDS)[0])
            self._after_type(at)
        else:
            self._take_motion(kind, at, word)
        return Token(word)

    def _take_part(self, at: int, part: int) -> Token:
        if part < 0:
            self._stack.pop()
            self._after_close()
            return Token(ID["<close>"])
        self._placed[part] = True
        self._stack.append(part)
        if at < 0:
            self.root = part
            self._ask_children(part)
        else:
            self.decisions[part].parent = at
            self._asks, self._part = "type", part
        return Token(ID["<child>"], part)

    def _after_type(self, part: int) -> None:
        if self._json_step or not self._moves(part):
            self._ask_children(part)
        else:
            self._asks, self._part = "slot", part

    def _moves(self, part: int) -> bool:
        """True if a part's motion has to be chosen."""
        lock = self.locked.get(part)
        fixed = self.decisions[part].type == TYPES.index("fixed")
        return part != self.root and not fixed and (lock is None or lock.type < 0)

    def _ask_children(self, part: int) -> None:
        self._asks, self._part = "child", part
        self._skip_closed()

    def _after_close(self) -> None:
        if self._stack:
            self._asks, self._part = "child", self._stack[-1]
            self._skip_closed()
        else:
            self._begin_urdf()

    def _skip_closed(self) -> None:
        """Force the close of nodes that can have no further child."""
        while self._stack and not self._possible(self._stack[-1]).any():
            self._pending.append(Token(ID["<close>"]))
            self._stack.pop()
        if self._stack:
            self._part = self._stack[-1]
        else:
            self._begin_urdf()

    def _begin_urdf(self) -> None:
        if self._json_step:
            self._pending += [Token(ID[t]) for t in ("<json_end>", "<urdf_start>", "<links>")]
            self._queue = [k for k in range(self.count) if self._moves(k)]
        self._next_joint()

    def _after_motion(self) -> None:
        if self._json_step:
            self._next_joint()
        else:
            self._ask_children(self._part)

    def _next_joint(self) -> None:
        if not self._queue:
            self._pending.append(Token(ID["<urdf_end>"]))
            self._asks = None
            return
        self._part = self._queue.pop(0)
        self._pending += [
            Token(ID["<joint>"], self._part),
            Token(int(TYPE_IDS[self.decisions[self._part].type])),
        ]
        self._asks = "slot"

    def _take_motion(self, kind: Kind, part: int, word: int) -> None:
        decision = self.decisions[part]
        limited = TYPES[decision.type] != "continuous"
        if kind == "slot":
            if word == ID["<free>"]:
                decision.slot = FREE
                self._asks = "number"
                return
            decision.slot = int(np.flatnonzero(word == SLOT_IDS)[0])
            self._after_axis(limited)
        elif kind == "number":
            decision.numbers.append(_level(word))
            if len(decision.numbers) == FREE_NUMBERS:
                self._after_axis(limited)
        elif kind == "lower":
            if word == ID["<as_offered>"]:
                self._after_motion()
            else:
                decision.lower = _level(word)
                self._asks = "upper"
        else:
            decision.upper = _level(word)
            self._after_motion()

    def _after_axis(self, limited: bool) -> None:
        if limited:
            self._asks = "lower"
        else:
            self._after_motion()


def _level(word: int) -> int:
    return int(np.flatnonzero(word == NUMBER_IDS)[0])
