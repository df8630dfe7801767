"""Arti4URDF as a predictor: the small network, alone or together with geometry.

Geometry and names give prior probabilities of the answer's words; network and rules give the
evidence for the confidence of a joint.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from copy import copy
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from model.core.articulated_object import ArticulatedObject, Prediction, SegmentedObject
from model.core.errors import ConfigurationError
from model.core.joint import Joint, same_motion
from model.core.motion_lexicon import MECHANISM_TABLE
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.answer import joints_of_decision, write_answer
from model.prediction.arti4urdf.choosing import (
    HybridSettings,
    geometric_prior,
    load_motion_ranker,
    motion_evidence,
    offered,
    other_motions,
    taught_steps,
)
from model.prediction.arti4urdf.decoding import Answer, ChoiceRecord, decode
from model.prediction.arti4urdf.decoding import same_motion as same_motions
from model.prediction.arti4urdf.network import SHIPPED, ArtiModel, Prompt, load_weights
from model.prediction.arti4urdf.structure import (
    MECHANISMS,
    RANKS,
    SLOTS,
    Structure,
    read_structure,
    structure_arrays,
)
from model.prediction.arti4urdf.vocabulary import Lock
from model.prediction.builder import (
    COLLISION_FREE,
    EXPERIENCE,
    FREE_AXIS,
    LEFT_OUT,
    MAX_LOG_ODDS,
    SWITCHES,
    Evidence,
    PredictionBuilder,
    as_on,
    explain,
    load_confidence,
    log_odds,
    unknown_link,
)
from model.prediction.experience import FILE, Experience, example_of, kind_of, load_experience
from model.prediction.geometric.context import PartContext, part_evidence
from model.prediction.geometric.mechanisms import swept_limits
from model.prediction.geometric.sampled_object import sample_object
from model.prediction.geometric.tree import rooted_tree
from model.prediction.lessons import (
    MOST,
    Lesson,
    decide,
    joints_of_steps,
    lessons,
    taught_tree,
)

Array = npt.NDArray[np.float64]


def joint_evidence(
    structure: Structure,
    answer: Answer,
    part: int,
    rules: Array,
    same: npt.NDArray[np.bool_],
    votes: Array | None = None,
) -> Evidence:
    """Evidence for the joint of one part.

    Args:
        structure, answer: of the object. part: its index.
        rules: (P, SIZE) log-probabilities from geometry and names alone.
        same: (P, SLOTS, SLOTS) candidates with the same motion.
        votes: (SLOTS,) log-shares of its candidates, see :func:`.motion_evidence`.
    """
    excluded = np.zeros_like(rules[part])
    if votes is not None:
        excluded[v.SLOT_IDS] = votes
    decision = answer.decisions[part]
    out = {"parent": log_odds(_parent_probability(answer, part))}
    for kind, chosen in (("type", decision.type), ("slot", decision.slot)):
        record = answer.record(part, kind)
        for expert in ("network", "rules"):
            out[f"{kind} {expert}"] = MAX_LOG_ODDS
            if record is not None:
                share = _share(record, rules[part], excluded, chosen, same[part], expert)
                out[f"{kind} {expert}"] = log_odds(share)
    slot = decision.slot
    mechanism = MECHANISMS[slot // RANKS] if 0 <= slot < SLOTS else None
    context = structure.contexts[part]
    if context.parent != decision.parent:
        parent = list(structure.assembly.parent)
        parent[part] = decision.parent
        context = PartContext(replace(structure.assembly, parent=parent), part)
    return out | part_evidence(context, mechanism)


def _parent_probability(answer: Answer, part: int) -> float:
    """Probability of a part's parent, or of the root."""
    if part == answer.root:
        record = answer.record(-1, "root")
        return record.probability if record is not None else 1.0
    parent = answer.decisions[part].parent
    found = 1.0
    for r in answer.records:
        if r.kind == "child" and r.part == parent and r.pointed == part:
            siblings = [k for k, d in enumerate(answer.decisions) if d.parent == parent]
            found = min(found, float(r.parts[siblings].sum()))
    return found


def _share(
    record: ChoiceRecord,
    rules: Array,
    excluded: Array,
    chosen: int,
    same: npt.NDArray[np.bool_],
    expert: str,
) -> float:
    """Probability, 0..1, that one of the two experts alone gives to the answer."""
    values = record.plain
    if expert == "rules":
        values = np.where(np.isfinite(record.plain), rules, -np.inf)
    weights = softmax(values + excluded)
    if record.kind == "type":
        return float(weights[v.TYPE_IDS[chosen]])
    slots = weights[v.SLOT_IDS]
    return float(weights[v.ID["<free>"]] if chosen >= len(slots) else (same @ slots)[chosen])


NOTHING: Mapping[int, Lesson] = {}
ALTERNATIVES = 2
"""Other motions of a joint that are offered."""
RULES_ALONE = 1000.0
"""Geometry's weight with which the network's reading no longer counts."""
APART, LINE = 0.15, 0.06
"""Motions differ from this angle between their axes on (rad), or this distance (diagonals)."""


class Arti4UrdfPredictor:
    """The small model.

    Args:
        model: in evaluation mode. name: as registered. version: of the weights.
        hybrid: None for the network alone.
        experience: of accepted objects; only the hybrid reads it.
        left_out: one of the mechanisms that :meth:`predict` does without, or "".
    """

    def __init__(
        self,
        model: ArtiModel,
        *,
        name: str = "arti4urdf",
        hybrid: HybridSettings | None = None,
        version: str = "",
        experience: Experience | None = None,
        left_out: str = "",
    ) -> None:
        self.name = name
        self.hybrid = hybrid
        self.model = model.eval()
        self.experience = experience
        self.left_out = left_out
        self.version = version

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.registry.Predictor`."""
        token = LEFT_OUT.set(self.left_out)
        try:
            given = {"locked": locked, "seed": seed, "progress": progress}
            return self.predict_with_evidence(segmented, **given)[0]
        finally:
            LEFT_OUT.reset(token)

    def predict_with_evidence(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
        structure: Structure | None = None,
    ) -> tuple[Prediction, dict[str, Evidence]]:
        """The prediction, and the evidence for its confidences by child link.

        Args:
            structure: of ``segmented`` and ``seed``, if it was read already.
        """
        links = tuple(p.link for p in segmented.parts)
        kind = "arti4urdf" if self.hybrid is None else "hybrid"
        builder = PredictionBuilder(segmented.parts, locked, load_confidence(kind))
        progress(0.0, "finding candidates")
        if structure is None:
            structure = read_structure(
                segmented,
                seed,
                progress=lambda fraction, message: progress(0.6 * fraction, message),
            )
        progress(0.6, "reading shapes")
        prompt = make_prompt(structure, segmented, seed)
        rules, same = geometric_prior(structure), same_motions(prompt)
        locks = _locks(locked, links, builder.problems)
        progress(0.8, "writing the tree")
        known = NOTHING
        if self.hybrid is not None and self.experience is not None:
            known = lessons(self.experience, structure.sampled)
            builder.checked = self.experience.checked.get(kind_of(segmented.category), (0, 0))
        answer = self.answer(prompt, structure, locks, self.prior(rules), known)
        assembly, votes = None, dict[int, Array]()
        if self.hybrid is not None:
            votes = motion_evidence(structure, rules)
            rank = load_motion_ranker()
            answer = rank(answer, structure, prompt.arrays, rules, same, frozenset(locks), votes)
            tree = [d.parent for d in answer.decisions]
            assembly = replace(structure.assembly, root=answer.root, parent=tree)
        kept = {j.child for j in locked}
        for i, link in enumerate(links):
            if i == answer.root or link in kept or answer.decisions[i].parent < 0:
                continue
            joints = joints_of_decision(structure, i, answer.decisions[i], assembly)
            evidence = joint_evidence(structure, answer, i, rules, same, votes.get(i))
            note, others = _note(structure, answer, i), []
            if i in known:
                joints, others, share = self.taught_joints(structure, answer, i, known[i], joints)
                note = explain(note, (), as_on(known[i].objects))
                evidence = {**evidence, EXPERIENCE: share}
            builder.add(joints, evidence, note)
            if assembly is not None:
                ranked = other_motions(answer, structure, i, rules[i], same[i])
                made = (joints_of_decision(structure, i, d, assembly) for d in ranked)
                builder.alternatives[link] = distinct_joints(
                    joints[-1], itertools.chain(others, made), structure.sampled.frame.diagonal
                )
        progress(1.0, "done")
        backend = f"{self.name} {self.version}".strip()
        made = builder.build(backend, seed, lambda tree: write_answer(tree, segmented))
        return made, builder.evidence

    def prior(self, rules: Array) -> Array:
        """(P, SIZE) log-probabilities to add to the network's; zeros for the network alone.

        Args:
            rules: (P, SIZE) of :func:`.geometric_prior`.
        """
        if self.hybrid is None:
            return np.zeros_like(rules)
        out = self.hybrid.weight * rules
        out[:, v.ID["<as_offered>"]] = self.hybrid.swept
        return out

    def answer(
        self,
        prompt: Prompt,
        structure: Structure,
        locks: dict[int, Lock],
        prior: Array,
        known: Mapping[int, Lesson] = NOTHING,
    ) -> Answer:
        """The likeliest answer; if hybrid, in geometry's tree.

        The network's own tree is the worse one on objects that neither has seen
        (docs/research/predictor.md).

        Args:
            prompt, structure: of the object.
            locks: parents and joints to keep, by part.
            prior: (P, SIZE) of :meth:`prior`. known: about parts, from accepted objects.
        """
        if self.hybrid is None:
            return decode(self.model, prompt, locked=locks)
        kept = {part: lock.parent for part, lock in locks.items()}
        root, above = structure.assembly.root, structure.assembly.parent
        if kept:
            root, above = rooted_tree(structure.sampled, kept, [])
        above = taught_tree(root, above, known, kept)
        tree = {i: Lock(p) for i, p in enumerate(above) if p >= 0}
        return decode(self.model, prompt, locked=tree | locks, prior=prior)

    def taught_joints(
        self,
        structure: Structure,
        answer: Answer,
        part: int,
        lesson: Lesson,
        plain: list[Joint],
    ) -> tuple[list[Joint], list[list[Joint]], float]:
        """The joints of a part after examples, those of its other motions, and the confidence.

        Args:
            plain: its joints without examples.
        """
        given, parent = offered(structure, answer, part), answer.decisions[part].parent
        ranked = decide(lesson, given)
        made = []
        for motion, _ in ranked[: ALTERNATIVES + 1]:
            steps = taught_steps(motion, given, lesson.foreseen >= MOST)
            same = steps == given[0][0]
            made.append(plain if same else joints_of_steps(structure.sampled, part, parent, steps))
        return made[0], made[1:], ranked[0][1]

    def with_example(self, accepted: ArticulatedObject, source: str) -> Arti4UrdfPredictor | None:
        """Itself with an accepted object as one more example, which counts whatever its kind
        brings; None where it reads no examples.

        Args:
            source: name of the accepted asset.
        """
        if self.hybrid is None:
            return None
        known = (self.experience or Experience()).without(source)
        used = (o for o in known.objects if kind_of(o.category) not in known.unused)
        parts = SegmentedObject(accepted.name, accepted.parts, accepted.category)
        example = example_of(accepted, source, sample_object(parts))
        out = copy(self)
        out.experience = replace(known, objects=(*used, example), unused=())
        return out


def distinct_joints(
    first: Joint, others: Iterable[Sequence[Joint]], diagonal: float
) -> tuple[Joint, ...]:
    """At most :data:`ALTERNATIVES` single joints whose motions differ from ``first``'s and from
    each other's, in their order.

    Args:
        diagonal: of the object, metres.
    """
    found: list[Joint] = []
    for joints in others:
        [*helpers, joint] = joints
        known = (first, *found)
        if not helpers and not any(same_motion(joint, k, APART, LINE * diagonal) for k in known):
            found.append(joint)
        if len(found) == ALTERNATIVES:
            break
    return tuple(found)


def make_prompt(structure: Structure, segmented: SegmentedObject, seed: int) -> Prompt:
    """The network's input for an object."""
    arrays = structure_arrays(structure, np.random.default_rng(seed))
    names = tuple(v.name_ids(s.name) for s in structure.sampled.shapes)
    return Prompt(arrays, v.category_id(segmented.category), names, np.arange(len(arrays)))


def _locks(
    locked: tuple[Joint, ...], links: tuple[str, ...], problems: list[str]
) -> dict[int, Lock]:
    """Locked joints by part; a joint below a helper link belongs to the part above."""
    index = {link: i for i, link in enumerate(links)}
    above = {j.child: j.parent for j in locked}
    out: dict[int, Lock] = {}
    for joint in locked:
        if joint.child not in index:
            if joint.child not in above.values():
                problems.append(unknown_link(joint))
            continue
        parent = joint.parent
        while parent not in index and parent in above:
            parent = above[parent]
        if parent in index:
            out[index[joint.child]] = Lock(index[parent], v.TYPES.index(joint.type))
    return out


def _note(structure: Structure, answer: Answer, part: int) -> str:
    """The explanation of a decision."""
    decision = answer.decisions[part]
    kind = v.TYPES[decision.type]
    slots = structure.slots[part]
    proposal = slots[decision.slot] if 0 <= decision.slot < len(slots) else None
    if proposal is None:
        return explain(kind.capitalize(), (), "" if decision.slot < 0 else FREE_AXIS)
    mechanism = MECHANISMS[decision.slot // RANKS]
    swept = swept_limits(mechanism) and decision.lower < 0 and decision.type != v.CONTINUOUS
    title = MECHANISM_TABLE["spin" if mechanism == v.TYPES[v.SCREW] else mechanism].title
    if decision.type == v.SCREW:
        title = kind.capitalize()
    return explain(title, proposal.reasons, COLLISION_FREE if swept else "")


def load_arti4urdf(
    folder: Path | None = None, *, name: str = "arti4urdf", hybrid: HybridSettings | None = None
) -> Arti4UrdfPredictor:
    """The predictor with the shipped weights, or those of a checkpoint folder.

    Raises:
        InputFileError: if the weights are absent or damaged.
    """
    model, version = load_weights(folder or SHIPPED)
    return Arti4UrdfPredictor(model, name=name, hybrid=hybrid, version=version)


@lru_cache(maxsize=2)
def hybrid(folder: str | None = None) -> Arti4UrdfPredictor:
    """The network with geometry beside it, with the shipped weights or those in ``folder``."""
    return load_arti4urdf(Path(folder) if folder else None, name="hybrid", hybrid=HybridSettings())


def learned_hybrid(experience: Experience | None, version: str = "") -> Arti4UrdfPredictor:
    """The hybrid with the shipped weights and the experience of a workspace.

    Args:
        version: of the experience, recorded with its predictions.
    """
    plain = hybrid()
    return Arti4UrdfPredictor(
        plain.model,
        name="hybrid",
        hybrid=plain.hybrid,
        version=f"{plain.version} {version}".rstrip(),
        experience=experience,
    )


def without(mechanism: str) -> Arti4UrdfPredictor:
    """The hybrid without one of its mechanisms.

    Raises:
        ConfigurationError: for one that isn't in :data:`~model.prediction.builder.SWITCHES`.
    """
    if mechanism not in SWITCHES:
        there = ", ".join(SWITCHES)
        raise ConfigurationError(f"no mechanism {mechanism!r} to leave out; there are {there}")
    alone = HybridSettings(weight=RULES_ALONE) if mechanism == "network" else HybridSettings()
    name, model = f"without:{mechanism}", hybrid().model
    return Arti4UrdfPredictor(model, name=name, hybrid=alone, left_out=mechanism)


def learned(folder: str) -> Arti4UrdfPredictor:
    """The hybrid with what ``artiworld train --workspace`` keeps in a folder.

    Raises:
        InputFileError: if the file is absent or damaged.
    """
    path = Path(folder)
    return learned_hybrid(load_experience(path / FILE), f"learned {path.name}")


@lru_cache(maxsize=2)
def network_alone(folder: str | None = None) -> Arti4UrdfPredictor:
    """The network alone, with the shipped weights or those in ``folder``."""
    return load_arti4urdf(Path(folder) if folder else None)
