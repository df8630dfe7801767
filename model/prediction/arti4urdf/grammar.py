"""What may be said next: the grammar of the answer over compact tokens.

The answer is the paper's reasoning chain: ``<json_start>``, the tree from the base down (a part,
its joint type, its children), ``<json_end>``, then ``<urdf_start>``, for each part that moves the
candidate that it turns about or slides along and its limits, ``<urdf_end>``. Everything that is
not a choice is forced and needs no forward pass of its own. Whatever is chosen, the answer parses:
one root, no cycle, every part once, limits in order.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import SLOTS

Kind = Literal["root", "child", "type", "slot", "number", "lower", "upper"]
Bools = npt.NDArray[np.bool_]

FREE_NUMBERS = 6
"""An axis (3) and the nearest point of its line to the part's centre (3)."""
FREE = SLOTS
"""Slot number that stands for "no candidate fits"."""


@dataclass(frozen=True)
class Token:
    """One token to append: a word, and the part that it points at (-1: none)."""

    word: int
    part: int = -1


@dataclass(frozen=True)
class Choice:
    """What has to be decided.

    Attributes:
        kind: of the decision.
        part: the part whose children ("child"), type, candidate or limits are asked for; -1 for
            the root's choice.
        words: (SIZE,) words that are allowed. parts: (P,) parts that may be pointed at.
    """

    kind: Kind
    part: int
    words: Bools
    parts: Bools


@dataclass
class Decision:
    """What has been decided about a part.

    Attributes:
        parent: part above, -1 at the root. type: index into ``TYPES``.
        slot: candidate, FREE, or -1 where none is needed.
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
    """A part whose place is settled: its parent, and its joint too where there is a type (>= 0)."""

    parent: int
    type: int = -1


class Grammar:
    """The state of one answer.

    Args:
        present: (P, SLOTS) which candidates there are. rotates: (P, SLOTS) which of them rotate.
        locked: part → its settled joint.
        json_step: write the tree first, then the motions; False decides each part's motion as soon
            as the part is placed, without the reasoning chain (an ablation of the paper).
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
        """Tokens to append before the next choice; they are handed out once."""
        out, self._pending = self._pending, []
        return out

    def choice(self) -> Choice | None:
        """The next decision, or None when the answer is complete."""
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
            settled = lock is not None and lock.type >= 0
            words[[v.TYPE_IDS[lock.type]] if lock is not None and settled else v.TYPE_IDS] = True
        elif kind == "slot":
            turning = v.TYPES[self.decisions[part].type] != "prismatic"
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
        """Decide: a word, or (for "root" and "child") a part. Gives the token to append.

        Raises:
            ValueError: where that is not allowed here.
        """
        asked = self.choice()
        allowed = asked is not None and (
            (0 <= part < self.count and asked.parts[part]) if part >= 0 else asked.words[word]
        )
        if asked is None or not allowed:
            raise ValueError(f"neither word {word} nor part {part} may come here: {asked}")
        kind, at = asked.kind, asked.part
        if kind in ("root", "child"):
            feed = self._take_part(at, part)
        elif kind == "type":
            self.decisions[at].type = int(np.flatnonzero(word == v.TYPE_IDS)[0])
            feed = Token(word)
            self._after_type(at)
        else:
            feed = Token(word)
            self._take_motion(kind, at, word)
        return feed

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
        """Whether a motion has to be decided for it."""
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
        """When all parts are placed, or a node can only be closed, closing is forced."""
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

    def copy(self) -> Grammar:
        """An independent state."""
        twin = object.__new__(Grammar)
        twin.__dict__.update(self.__dict__)
        twin.decisions = [replace(d, numbers=list(d.numbers)) for d in self.decisions]
        twin._placed = self._placed.copy()
        twin._stack, twin._queue = list(self._stack), list(self._queue)
        twin._pending = list(self._pending)
        return twin


def _level(word: int) -> int:
    return int(np.flatnonzero(word == v.NUMBER_IDS)[0])
