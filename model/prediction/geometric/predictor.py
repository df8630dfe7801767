"""The predictor without a network: geometry, names and a motion sweep."""

from __future__ import annotations

from functools import partial

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint
from model.core.motion_lexicon import MECHANISM_TABLE
from model.core.progress import Progress, no_progress
from model.prediction.builder import (
    MAX_LOG_ODDS,
    Evidence,
    PredictionBuilder,
    explain,
    load_confidence,
    log_odds,
    unknown_link,
)
from model.prediction.geometric.context import (
    Assembly,
    JointProposal,
    PartContext,
    best_share,
    distinct_motions,
    joints_of,
    part_evidence,
)
from model.prediction.geometric.limits import from_zero
from model.prediction.geometric.mechanisms import face_front, propose
from model.prediction.geometric.roles import MechanismGuess, guess_mechanisms
from model.prediction.geometric.sampled_object import CONTACT_GAP, SampledObject, sample_object
from model.prediction.geometric.tree import rooted_tree

BACKEND = "geometric 1"


class GeometricPredictor:
    """Joints from contact, boxes, symmetry, handles and names; deterministic, CPU only."""

    name = "geometric"

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.registry.Predictor`."""
        return self.predict_with_evidence(segmented, locked=locked, seed=seed, progress=progress)[0]

    def predict_with_evidence(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> tuple[Prediction, dict[str, Evidence]]:
        """The prediction, and the evidence for its confidences by child link."""
        links = tuple(p.link for p in segmented.parts)
        builder = PredictionBuilder(segmented.parts, locked, load_confidence(self.name))
        progress(0.0, "sampling surfaces")
        sampled = sample_object(segmented, seed)
        progress(0.3, "finding contacts")
        faults: list[str] = []
        root, parent = _tree(sampled, locked, builder.problems, faults)
        assembly = Assembly(sampled, root, parent, faults=faults)
        guesses = guess_mechanisms(assembly)
        face_front(assembly, {i: g.mechanism for i, g in guesses.items()})
        kept = {j.child for j in locked}
        moving = [i for i in range(len(sampled)) if i != root]
        for step, i in enumerate(moving):
            progress(0.4 + 0.6 * step / len(moving), f"joint of {links[i]}")
            if links[i] in kept:
                continue
            context = PartContext(assembly, i)
            added = context.attempt("its joint", partial(_add, builder, context, guesses[i]), False)
            if not added:
                builder.add(*_fixed(context))
        builder.problems += dict.fromkeys(faults)
        progress(1.0, "done")
        return builder.build(BACKEND, seed), builder.evidence


def _add(builder: PredictionBuilder, context: PartContext, guess: MechanismGuess) -> bool:
    """Add the joint of one part."""
    sampled, part = context.sampled, context.part
    found = propose(context, guess.mechanism)
    share = best_share(distinct_motions(found))
    odds = {"type rules": log_odds(guess.probability), "slot rules": log_odds(share)}
    source = f'From the name "{context.shape.name}"' if guess.named else "From the shape"
    problems = _problems(context)
    builder.add(
        joints_of(sampled, part, context.parent, from_zero(context, found[0])),
        odds | part_evidence(context, guess.mechanism),
        explain(_title(found[0]), found[0].reasons, source),
    )
    builder.problems += problems
    return True


def _fixed(context: PartContext) -> tuple[list[Joint], Evidence, str]:
    """A fixed joint for a part whose own joint failed, with no confidence."""
    link = context.shape.link
    doubt = {"type rules": -MAX_LOG_ODDS, "slot rules": -MAX_LOG_ODDS}
    joint = Joint(f"joint_{link}", "fixed", context.parent_shape.link, link)
    return [joint], doubt, "Fixed, because its rules failed"


def _title(proposal: JointProposal) -> str:
    return MECHANISM_TABLE[proposal.mechanism or "fixed"].title


def _tree(
    sampled: SampledObject, locked: tuple[Joint, ...], problems: list[str], faults: list[str]
) -> tuple[int, list[int]]:
    """Root and parents, with the parents of locked joints."""
    index = {s.link: i for i, s in enumerate(sampled.shapes)}
    problems += [unknown_link(j) for j in locked if j.child not in index]
    kept = {index[j.child]: index.get(j.parent, -1) for j in locked if j.child in index}
    return rooted_tree(sampled, kept, faults)


def _problems(context: PartContext) -> list[str]:
    link, above = context.shape.link, context.parent_shape.link
    gap = float(context.sampled.gap[context.part, context.parent])
    out = []
    if gap > 4 * CONTACT_GAP:
        metres = gap * context.sampled.frame.diagonal
        out.append(f"{link} isn't in contact with {above}: the gap is {metres:.3g} m")
    if len(context.shape.points) < 20:
        out.append(f"{link} has only {len(context.shape.points)} points: its joint is uncertain")
    return out
