"""Arti4URDF behind the Predictor protocol: the network, alone or with geometry beside it."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import joints_of_decision, write_answer
from model.prediction.arti4urdf.decoding import Answer, decode, same_motion
from model.prediction.arti4urdf.evidence import evidence_of
from model.prediction.arti4urdf.geometric_prior import geometric_prior
from model.prediction.arti4urdf.grammar import Lock
from model.prediction.arti4urdf.motion_check import checked
from model.prediction.arti4urdf.network import ArtiModel, Prompt
from model.prediction.arti4urdf.structure import Structure, read_structure, structure_arrays
from model.prediction.confidence import Evidence, doubt, weighing_of
from model.prediction.geometric.predictor import assemble

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class HybridSettings:
    """Where geometry leads.

    Attributes:
        tree: geometry's tree is kept where the network gives another parent less than this
            probability; 0 never asks geometry, 1 always does.
        weight: of geometry's opinion on joint types and candidates, in a product of experts.
        swept: log-odds added in favour of the candidate's own limits, from rules and motion sweep.
        motion: exponent of the share of its range that a candidate moves freely.
    """

    tree: float = 0.999
    weight: float = 5.0
    swept: float = 10.0
    motion: float = 1.0


class Arti4UrdfPredictor:
    """The small model with its shipped weights, or weights from a folder.

    Args:
        model: in evaluation mode.
        name: as registered. hybrid: None is the network alone.
        version: of the weights, for the record.
    """

    def __init__(
        self,
        model: ArtiModel,
        *,
        name: str = "arti4urdf",
        hybrid: HybridSettings | None = None,
        version: str = "",
    ) -> None:
        self.name = name
        self.hybrid = hybrid
        self.model = model.eval()
        self._version = version

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.protocol.Predictor`."""
        return self.explained(segmented, locked=locked, seed=seed, progress=progress)[0]

    def explained(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
        structure: Structure | None = None,
    ) -> tuple[Prediction, dict[str, Evidence]]:
        """The prediction, and by child link what its confidences are made of.

        Args:
            structure: of ``segmented`` and ``seed``, where it was read already.
        """
        start = time.perf_counter()
        progress(0.0, "finding candidates")
        if structure is None:
            structure = read_structure(
                segmented,
                seed,
                progress=lambda fraction, message: progress(0.6 * fraction, message),
            )
        progress(0.6, "reading shapes")
        prompt = make_prompt(structure, segmented, seed)
        links = [s.link for s in structure.scene.shapes]
        locks, problems = _locks(locked, links)
        rules, same = geometric_prior(structure), same_motion(prompt)
        prior = None
        if self.hybrid is not None:
            prior = self.hybrid.weight * rules
            prior[:, v.ID["<as_offered>"]] = self.hybrid.swept
        answer = decode(self.model, prompt, locked=locks, prior=prior)
        progress(0.8, "writing the tree")
        if self.hybrid is not None and self._doubts_tree(answer, structure):
            parents = structure.assembly.parent
            settled = {i: Lock(p) for i, p in enumerate(parents) if p >= 0}
            answer = decode(self.model, prompt, locked=settled | locks, prior=prior)
        if self.hybrid is not None and self.hybrid.motion:
            answer = checked(answer, structure, same, self.hybrid.motion)
        joints: list[Joint] = []
        helpers: list[str] = []
        sure: dict[str, float] = {}
        known: dict[str, Evidence] = {}
        weighing = weighing_of("arti4urdf" if self.hybrid is None else "hybrid")
        notes: dict[str, str] = {}
        kept = {j.child for j in locked}
        parents = [d.parent for d in answer.decisions]
        hung = replace(structure.assembly, root=answer.root, parent=parents)
        hung = hung if self.hybrid is not None else None
        for i, link in enumerate(links):
            if i == answer.root or link in kept or answer.decisions[i].parent < 0:
                continue
            built = joints_of_decision(structure, i, answer.decisions[i], hung)
            joints += built
            helpers += [j.child for j in built[:-1]]
            above = parent_confidence(answer, i)
            known[link] = evidence_of(structure, answer, i, rules, same, above)
            sure[link] = weighing.of(known[link])
            notes[link] = "; ".join(filter(None, (_note(structure, answer, i), doubt(known[link]))))
        tree, trouble = assemble(tuple(links), tuple(helpers), joints, locked)
        sure.update({j.child: 1.0 for j in locked})
        notes.update({j.child: "settled by the person" for j in locked})
        text = write_answer(tree, segmented) if tree is not None else ""
        progress(1.0, "done")
        made = Prediction(
            tree,
            (*problems, *trouble),
            sure,
            f"{self.name} {self._version}".strip(),
            seed,
            time.perf_counter() - start,
            text,
            notes,
        )
        return made, known

    def _doubts_tree(self, answer: Answer, structure: Structure) -> bool:
        """Whether the network is unsure of a parent where geometry names another."""
        assert self.hybrid is not None
        return any(
            answer.decisions[i].parent != parent and parent_confidence(answer, i) < self.hybrid.tree
            for i, parent in enumerate(structure.assembly.parent)
        )


def make_prompt(structure: Structure, segmented: SegmentedObject, seed: int) -> Prompt:
    """What the network reads of an object."""
    arrays = structure_arrays(structure, np.random.default_rng(seed))
    names = tuple(v.name_ids(s.name) for s in structure.scene.shapes)
    return Prompt(arrays, v.category_id(segmented.category), names, np.arange(len(arrays)))


def _locks(locked: tuple[Joint, ...], links: list[str]) -> tuple[dict[int, Lock], list[str]]:
    """Settled joints as forced spans; joints below helper links count from the part above."""
    index = {link: i for i, link in enumerate(links)}
    above = {j.child: j.parent for j in locked}
    out: dict[int, Lock] = {}
    problems: list[str] = []
    for joint in locked:
        if joint.child not in index:
            if joint.child not in above.values():
                problems.append(f"locked joint {joint.name!r} names a link that isn't there")
            continue
        parent = joint.parent
        while parent not in index and parent in above:
            parent = above[parent]
        if parent in index:
            out[index[joint.child]] = Lock(index[parent], v.TYPES.index(joint.type))
    return out, problems


def parent_confidence(answer: Answer, part: int) -> float:
    """Probability that the part hangs where it was put (or is the root)."""
    if part == answer.root:
        made = [m for m in answer.made if m.kind == "root"]
        return made[0].probability if made else 1.0
    parent = answer.decisions[part].parent
    found = 1.0
    for m in answer.made:
        if m.kind == "child" and m.part == parent:
            siblings = [k for k, d in enumerate(answer.decisions) if d.parent == parent]
            mass = float(m.parts[siblings].sum())
            if m.pointed == part:
                found = min(found, mass)
    return found


def _note(structure: Structure, answer: Answer, part: int) -> str:
    decision = answer.decisions[part]
    kind = v.TYPES[decision.type]
    if decision.slot < 0:
        return kind
    offered = (
        structure.slots[part][decision.slot] if decision.slot < len(structure.slots[part]) else None
    )
    where = offered.note if offered is not None else "no candidate fitted: axis and line in numbers"
    limits = "" if decision.lower >= 0 else "; range by the motion sweep"
    return f"{kind}; {where}{limits if kind != 'continuous' else ''}"


def load_arti4urdf(
    folder: Path | None = None, *, name: str = "arti4urdf", hybrid: HybridSettings | None = None
) -> Arti4UrdfPredictor:
    """The predictor with the shipped weights, or those of a checkpoint folder.

    Raises:
        InputFileError: where the weights are absent or damaged.
    """
    from model.prediction.arti4urdf.weights import SHIPPED, load_weights

    model, version = load_weights(folder or SHIPPED)
    return Arti4UrdfPredictor(model, name=name, hybrid=hybrid, version=version)


@lru_cache(maxsize=2)
def hybrid(folder: str | None = None) -> Arti4UrdfPredictor:
    """The network with geometry beside it, with the shipped weights or those in ``folder``."""
    return load_arti4urdf(Path(folder) if folder else None, name="hybrid", hybrid=HybridSettings())


@lru_cache(maxsize=2)
def network_alone(folder: str | None = None) -> Arti4UrdfPredictor:
    """The network alone, with the shipped weights or those in ``folder``."""
    return load_arti4urdf(Path(folder) if folder else None)
