"""The answer as text in steps: forced text, and small choices.

The steps follow :func:`model.prediction.arti4urdf.answer.write_answer` to the letter, and
:class:`model.prediction.arti4urdf.vocabulary.Grammar` decides which part may come next. So every
sequence of choices gives one tree with every part once and a URDF that parses, with nonzero axes
and limits in order.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Generator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from model.core.articulated_object import SegmentedObject
from model.core.joint import JOINT_TYPES, Joint, JointType
from model.core.tree import KinematicTree
from model.io.urdf.writer import vector
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import (
    DECIMALS,
    JSON_END,
    JSON_START,
    URDF_START,
    write_answer,
)
from model.prediction.arti4urdf.structure import SLOTS
from model.prediction.arti4urdf.vocabulary import Choice, Grammar, Lock

WHOLE_DIGITS = 3


@dataclass(frozen=True)
class OneOf:
    """A choice among texts, none a prefix of another; ``about`` is the link that it concerns."""

    about: str
    texts: tuple[str, ...]


@dataclass(frozen=True)
class Numbers:
    """A choice of ``count`` decimal numbers with blanks between them, up to the closing quote.

    Attributes:
        about: the link that they concern. kind: of the numbers.
        nonzero: not all may be zero. least: lower bound of each.
    """

    about: str
    kind: str
    count: int = 3
    nonzero: bool = False
    least: float | None = None

    def allows(self, text: str, *, complete: bool = False) -> bool:
        """True if the numbers may begin with ``text``, or equal it if ``complete``."""
        words = text.split(" ")
        if len(words) > self.count or (complete and len(words) < self.count):
            return False
        if not all(_NUMBER.fullmatch(w) for w in words[:-1]):
            return False
        last = words[-1]
        if not (_NUMBER if complete else _PARTIAL).fullmatch(last):
            return False
        reach = [(float(w), float(w)) for w in words[:-1]]
        reach.append((float(last), float(last)) if complete else _reach(last))
        if self.least is not None and any(high < self.least for _, high in reach):
            return False
        may_grow = not complete and len(words) < self.count
        largest = max(max(abs(low), abs(high)) for low, high in reach)
        return may_grow or not self.nonzero or largest > SMALLEST_AXIS


SMALLEST_AXIS = 1e-3
_NUMBER = re.compile(rf"-?\d{{1,{WHOLE_DIGITS}}}(\.\d{{1,{DECIMALS}}})?")
_PARTIAL = re.compile(rf"-?(\d{{1,{WHOLE_DIGITS}}}(\.\d{{0,{DECIMALS}}})?)?")


def _reach(begun: str) -> tuple[float, float]:
    """Bounds of the numbers that begin with a text."""
    whole, _, after = begun.lstrip("-").partition(".")
    most = float("9" * WHOLE_DIGITS + "." + "9" * DECIMALS)
    if not whole:
        return (-most, 0.0) if begun else (-most, most)
    longest = whole if "." in begun else whole.ljust(WHOLE_DIGITS, "9")
    low, high = float(f"{whole}.{after}0"), float(f"{longest}.{after.ljust(DECIMALS, '9')}")
    return (-high, -low) if begun.startswith("-") else (low, high)


Step = str | OneOf | Numbers
Script = Generator[Step, str, None]


@dataclass(eq=False)
class _Node:
    """A link whose children are being written; ``closes`` links (its helpers) end with it."""

    depth: int
    children: int = 0
    closes: int = 1


class _Json:
    """Pieces of text in the layout of ``json.dumps(…, indent=1)``."""

    def __init__(self) -> None:
        self.stack: list[_Node] = []

    def open(self, link: str) -> str:
        """Begin a child of the last node, up to its name."""
        top = self.stack[-1]
        return self._begin(top.depth, first=top.children == 0) + f'{link}",\n'

    def _begin(self, depth: int, *, first: bool) -> str:
        pad = " " * (2 * depth + 2)
        return f'{"[" if first else ","}\n{pad}{{\n{pad} "part": "'

    def joint(self, name: str, above: int) -> str:
        """Joint name of a link ``above`` + 1 levels below the last node, up to its children."""
        pad = " " * (2 * (self.stack[-1].depth + above + 1) + 1)
        return f'",\n{pad}"joint_name": "{name}",\n{pad}"children": '

    def joint_type(self, above: int) -> str:
        """The key of that joint's type."""
        return " " * (2 * (self.stack[-1].depth + above + 1) + 1) + '"joint_type": "'

    def below(self, above: int, link: str) -> str:
        """Begin the only child of a helper link."""
        return self._begin(self.stack[-1].depth + above, first=True) + f'{link}",\n'

    def pushed(self, links: int) -> None:
        """Add a child to the last node, with ``links`` - 1 helpers above it."""
        top = self.stack[-1]
        top.children += 1
        self.stack.append(_Node(top.depth + links, closes=links))

    def close(self) -> str:
        """End the children of the last node and the node itself."""
        top = self.stack[-1]
        out = "[]" if not top.children else f"\n{' ' * (2 * top.depth + 1)}]"
        for k in range(top.closes):
            depth = top.depth - k
            out += f"\n{' ' * (2 * depth)}}}"
            if k + 1 < top.closes:
                out += f"\n{' ' * (2 * depth - 1)}]"
        return out


class AnswerScript:
    """The steps of one answer.

    Args:
        segmented: the parts. locked: joints that are forced.
    """

    def __init__(self, segmented: SegmentedObject, locked: Sequence[Joint] = ()) -> None:
        self.segmented = segmented
        self.links = [p.link for p in segmented.parts]
        self._joint_above = {j.child: j for j in locked}
        self.joints: dict[str, Joint] = {}
        """Child link → joint with the values that are known so far."""
        self.forced: set[str] = set()
        self._axes: dict[str, str] = {}

    def steps(self) -> Script:
        """The steps; send the text of each choice."""
        yield f"{JSON_START}\n"
        yield from self._tree()
        yield f"\n{JSON_END}\n{URDF_START}\n"
        yield from self._urdf()

    def _chain(self, part: int) -> list[Joint] | None:
        """The locked joints between the parent part and ``part``, with those of helpers."""
        out: list[Joint] = []
        link = self.links[part]
        while link in self._joint_above and len(out) <= len(self._joint_above):
            out.insert(0, self._joint_above[link])
            link = out[0].parent
            if link in self.links:
                return out
        return None

    def _locks(self) -> dict[int, Lock]:
        chains = {i: self._chain(i) for i in range(len(self.links))}
        return {
            i: Lock(self.links.index(chain[0].parent), v.TYPES.index(chain[-1].type))
            for i, chain in chains.items()
            if chain is not None
        }

    def _tree(self) -> Script:
        locks = self._locks()
        nothing = np.zeros((len(self.links), SLOTS), bool)
        grammar = Grammar(nothing, nothing, locks)
        json = _Json()
        text = '{\n "part": "'
        while True:
            closed = [f for f in grammar.forced() if f.word == v.ID["<close>"]]
            for _ in closed:
                text += json.close()
                json.stack.pop()
            choice = grammar.choice()
            if choice is None or choice.kind not in ("root", "child"):
                break
            if choice.kind == "root":
                options = {
                    self.links[p] + '",\n "children": ': (int(p), False)
                    for p in np.flatnonzero(choice.parts)
                }
            else:
                options = self._children(choice, json, locks)
            yield text
            text = ""
            about = "" if choice.part < 0 else self.links[choice.part]
            taken, screw = options[(yield from _choose(about, tuple(options)))]
            if taken < 0:
                json.stack.pop()
                grammar.take(v.ID["<close>"])
                continue
            grammar.take(-1, taken)
            if choice.kind == "root":
                json.stack.append(_Node(0))
                continue
            kind, text = yield from self._joint(taken, choice.part, screw, json, taken in locks)
            grammar.take(int(v.TYPE_IDS[kind]))
        yield text

    def _children(
        self, choice: Choice, json: _Json, locks: dict[int, Lock]
    ) -> dict[str, tuple[int, bool]]:
        """Text → the part that it opens (-1 closes), and whether with a new helper above it."""
        out: dict[str, tuple[int, bool]] = {}
        for p in np.flatnonzero(choice.parts):
            chain = self._chain(int(p)) if int(p) in locks else None
            out[json.open(chain[0].child if chain else self.links[p])] = (int(p), False)
            helper = helper_name(self.links[p])
            if chain is None and helper not in self.links:
                out[json.open(helper)] = (int(p), True)
        if choice.words[v.ID["<close>"]]:
            out[json.close()] = (-1, False)
        return out

    def _joint(
        self, part: int, parent: int, screw: bool, json: _Json, locked: bool
    ) -> Generator[Step, str, tuple[int, str]]:
        """Types and names of the joints down to ``part``; returns its type and the pending text."""
        link, above = self.links[part], self.links[parent]
        chain = self._chain(part) if locked else None
        if screw:
            helper = helper_name(link)
            chain = [
                Joint(f"joint_{helper}", "prismatic", above, helper, lower=0.0, upper=0.0),
                Joint(f"joint_{link}", "continuous", helper, link),
            ]
        elif chain is not None:
            self.forced |= {j.child for j in chain}
        if chain is not None:
            text = ""
            for k, joint in enumerate(chain):
                text += json.below(k, joint.child) if k else ""
                text += json.joint_type(k) + joint.type + json.joint(joint.name, k)
                self.joints[joint.child] = joint
            json.pushed(len(chain))
            return (v.SCREW if screw else v.TYPES.index(chain[-1].type)), text
        yield json.joint_type(0)
        name = json.joint(f"joint_{link}", 0)
        kinds: dict[str, JointType] = {t + name: t for t in JOINT_TYPES}
        kind = kinds[(yield from _choose(link, tuple(kinds)))]
        self.joints[link] = Joint(f"joint_{link}", kind, above, link, lower=0.0, upper=0.0)
        json.pushed(1)
        return v.TYPES.index(kind), ""

    def _urdf(self) -> Script:
        """The URDF of the tree as :func:`write_answer` writes it, with its numbers as choices."""
        helpers = tuple(c for c in self.joints if c not in self.links)
        tree = KinematicTree((*self.links, *helpers), tuple(self.joints.values()))
        body = write_answer(tree, self.segmented).split(URDF_START + "\n", 1)[1]
        origins: dict[str, np.ndarray] = {tree.root: np.zeros(3)}
        for link in tree.order:
            if link in self.forced:
                origins[link] = np.array(self.joints[link].origin)
        order = iter(tree.order)
        joints = iter(tree.order[1:])
        link, in_joint = "", False
        for line in body.splitlines(keepends=True):
            if line.startswith("  <link name="):
                link = next(order)
            elif line.startswith("  <joint name="):
                link, in_joint = next(joints), True
            if "<origin xyz=" in line:
                if in_joint:
                    above = self._origin(tree.joint_of[link].parent, origins)
                    offset = self._origin(link, origins) - above
                    yield _filled(line, "xyz", vector(np.round(offset, DECIMALS)))
                elif link in origins:
                    yield _filled(line, "xyz", vector(np.round(-origins[link], DECIMALS)))
                else:
                    text = yield from _with_choice(line, "xyz", Numbers(link, "origin"))
                    origins[link] = -np.array([float(x) for x in text.split(" ")])
            elif "<axis xyz=" in line or "<limit lower=" in line:
                yield from self._motion(line, tree.joint_of[link])
            else:
                yield line

    def _origin(self, link: str, origins: dict[str, np.ndarray]) -> np.ndarray:
        """Origin of a link; a helper has that of its child."""
        while link not in origins:
            link = next(j.child for j in self.joints.values() if j.parent == link)
        return origins[link]

    def _motion(self, line: str, joint: Joint) -> Script:
        """The line with the axis or the limits of a joint."""
        link = joint.child
        if link in self.forced:
            yield line
        elif "<axis" in line:
            first = self.joints.get(joint.parent)
            if joint.parent not in self.links and first is not None:
                yield _filled(line, "xyz", self._axes[joint.parent])  # both of a screw
            else:
                ask = Numbers(link, "axis", nonzero=True)
                self._axes[link] = yield from _with_choice(line, "xyz", ask)
        else:
            before, rest = line.split('upper="', 1)
            lower = yield from _with_choice(before, "lower", Numbers(link, "limits", 1))
            after = 'upper="' + rest
            yield from _with_choice(after, "upper", Numbers(link, "limits", 1, least=float(lower)))


def helper_name(link: str) -> str:
    """Name of the helper link above ``link`` in a compound motion."""
    return f"helper_{link.removeprefix('link_')}"


def as_written(tree: KinematicTree, parts: Collection[str]) -> KinematicTree:
    """The same motions in the form that a model is trained to write.

    Compound motions have the prismatic joint first; joints are named after their children and
    lose their mimics.

    Args:
        tree: of an object. parts: links that are no helpers.
    """
    joints = {j.child: j for j in tree.joints}
    for link in [k for k in tree.links if k not in parts]:
        below = [j for j in joints.values() if j.parent == link]
        first = joints.get(link)
        if first is None or len(below) != 1 or below[0].child not in parts:
            continue
        pair = {j.type: j for j in (first, below[0])}
        if set(pair) == {"continuous", "prismatic"}:
            part, helper = below[0].child, helper_name(below[0].child)
            del joints[link]
            joints[helper] = replace(pair["prismatic"], parent=first.parent, child=helper)
            joints[part] = replace(pair["continuous"], parent=helper, child=part)
    named = tuple(replace(j, name=f"joint_{j.child}", mimic=None) for j in joints.values())
    return KinematicTree((tree.root, *(j.child for j in named)), named)


def _choose(about: str, texts: tuple[str, ...]) -> Generator[Step, str, str]:
    """Choose a text, or force the only one."""
    if len(texts) == 1:
        yield texts[0]
        return texts[0]
    return (yield OneOf(about, texts))


def _filled(line: str, name: str, value: str) -> str:
    return re.sub(rf'{name}="[^"]*"', f'{name}="{value}"', line, count=1)


def _with_choice(line: str, name: str, ask: Numbers) -> Generator[Step, str, str]:
    """The line with an attribute as a choice; returns the attribute's text."""
    start = line.index(f'{name}="') + len(name) + 2
    yield line[:start]
    text = yield ask
    yield line[line.index('"', start) :]
    return text
