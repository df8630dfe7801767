"""The grammar of the answer over compact tokens: which words and parts may come next.

The answer is the paper's reasoning chain: ``<json_start>``, the tree from the base down (a part,
its joint type, its children), ``<json_end>``, then ``<urdf_start>``, the candidate joint and the
limits of each moving part, ``<urdf_end>``. Tokens without an alternative are forced and need no
forward pass of their own. Every sequence of choices parses: one root, no cycle, every part once,
limits in order.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import SLOTS

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
    type: int = v.TYPES.index("fixed")
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
        self._pending = [Token(v.ID["<json_start>" if json_step else "<urdf_start>"])]
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
        words, parts = np.zeros(v.SIZE, bool), np.zeros(self.count, bool)
        kind, part = self._asks, self._part
        if kind == "root":
            parts[:] = True
            parts[[k for k in self.locked if 0 <= k < self.count]] = False
            if not parts.any():
                parts[:] = True
        elif kind == "child":
            parts = self._possible(part)
            words[v.ID["<close>"]] = self._may_close(part)
        elif kind == "type":
            lock = self.locked.get(part)
            given = lock is not None and lock.type >= 0
            words[[v.TYPE_IDS[lock.type]] if lock is not None and given else v.TYPE_IDS] = True
        elif kind == "slot":
            turning = self.decisions[part].type != v.PRISMATIC
            words[v.SLOT_IDS[self._present[part] & (self._rotates[part] == turning)]] = True
            words[v.ID["<free>"]] = True
        elif kind == "number":
            words[v.NUMBER_IDS] = True
        elif kind == "lower":
            words[v.NUMBER_IDS] = True
            words[v.ID["<as_offered>"]] = self.decisions[part].slot != FREE
        else:
            words[v.NUMBER_IDS[self.decisions[part].lower :]] = True
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
            self.decisions[at].type = int(np.flatnonzero(word == v.TYPE_IDS)[0])
            self._after_type(at)
        else:
            self._take_motion(kind, at, word)
        return Token(word)

    def _take_part(self, at: int, part: int) -> Token:
        if part < 0:
            self._stack.pop()
            self._after_close()
            return Token(v.ID["<close>"])
        self._placed[part] = True
        self._stack.append(part)
        if at < 0:
            self.root = part
            self._ask_children(part)
        else:
            self.decisions[part].parent = at
            self._asks, self._part = "type", part
        return Token(v.ID["<child>"], part)

    def _after_type(self, part: int) -> None:
        if self._json_step or not self._moves(part):
            self._ask_children(part)
        else:
            self._asks, self._part = "slot", part

    def _moves(self, part: int) -> bool:
        """True if a part's motion has to be chosen."""
        lock = self.locked.get(part)
        fixed = self.decisions[part].type == v.TYPES.index("fixed")
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
            self._pending.append(Token(v.ID["<close>"]))
            self._stack.pop()
        if self._stack:
            self._part = self._stack[-1]
        else:
            self._begin_urdf()

    def _begin_urdf(self) -> None:
        if self._json_step:
            self._pending += [Token(v.ID[t]) for t in ("<json_end>", "<urdf_start>", "<links>")]
            self._queue = [k for k in range(self.count) if self._moves(k)]
        self._next_joint()

    def _after_motion(self) -> None:
        if self._json_step:
            self._next_joint()
        else:
            self._ask_children(self._part)

    def _next_joint(self) -> None:
        if not self._queue:
            self._pending.append(Token(v.ID["<urdf_end>"]))
            self._asks = None
            return
        self._part = self._queue.pop(0)
        self._pending += [
            Token(v.ID["<joint>"], self._part),
            Token(int(v.TYPE_IDS[self.decisions[self._part].type])),
        ]
        self._asks = "slot"

    def _take_motion(self, kind: Kind, part: int, word: int) -> None:
        decision = self.decisions[part]
        limited = v.TYPES[decision.type] != "continuous"
        if kind == "slot":
            if word == v.ID["<free>"]:
                decision.slot = FREE
                self._asks = "number"
                return
            decision.slot = int(np.flatnonzero(word == v.SLOT_IDS)[0])
            self._after_axis(limited)
        elif kind == "number":
            decision.numbers.append(_level(word))
            if len(decision.numbers) == FREE_NUMBERS:
                self._after_axis(limited)
        elif kind == "lower":
            if word == v.ID["<as_offered>"]:
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
    return int(np.flatnonzero(word == v.NUMBER_IDS)[0])
