"""What the gate says: a verdict and one plain sentence a joint, worst first."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, get_args

from model.core.joint import Joint
from model.validation.physics_report import PhysicsReport

Verdict = Literal["fine", "look", "broken"]
Kind = Literal[
    "collision", "combination", "detached", "jammed", "floating", "limits", "geometry", "physics",
    "unsure",
]  # fmt: skip
MendKind = Literal["flip", "shift", "limits", "shrink"]
VERDICTS: tuple[Verdict, ...] = get_args(Verdict)
SEVERE: tuple[Kind, ...] = (
    "geometry", "jammed", "floating", "limits", "collision", "detached", "physics", "combination",
    "unsure",
)  # fmt: skip
"""What is told first of findings that are equally bad."""

FREE = "Moves freely over its range."


def worst_of(verdicts: Iterable[Verdict]) -> Verdict:
    """The worst verdict; "fine" of none."""
    return VERDICTS[max((VERDICTS.index(v) for v in verdicts), default=0)]


@dataclass(frozen=True)
class Finding:
    """One thing that was seen.

    Attributes:
        kind: what was looked at. verdict: how bad it is. sentence: for people.
        depth: metres: of a collision, or how far a part is off what should hold it.
        q: joint values at the worst moment; joints that aren't there are at 0.
        where: (3,) the contact at that moment, object frame; None where there is none.
        other: the other link, or None.
    """

    kind: Kind
    verdict: Verdict
    sentence: str
    depth: float = 0.0
    q: Mapping[str, float] = field(default_factory=dict)
    where: tuple[float, float, float] | None = None
    other: str | None = None


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """In the order in which they are told."""
    return tuple(sorted(findings, key=lambda f: (-VERDICTS.index(f.verdict), SEVERE.index(f.kind))))


@dataclass(frozen=True)
class Mend:
    """A changed joint with which the gate finds nothing wrong any more (of what it mends).

    Attributes:
        kind: flip the direction, shift the axis, set the limits, or shrink the collision shapes.
        joint: takes the place of its child's joint.
        sentence: for people.
    """

    kind: MendKind
    joint: Joint
    sentence: str


@dataclass(frozen=True)
class JointVerdict:
    """How one joint stands.

    Attributes:
        joint: its name. child: the link that it moves.
        findings: worst first; without any it moves freely.
        mends: best first, each tried out, but for shrinking, which works by construction.
    """

    joint: str
    child: str
    findings: tuple[Finding, ...] = ()
    mends: tuple[Mend, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The worst of the findings."""
        return worst_of(f.verdict for f in self.findings)

    @property
    def worst(self) -> Finding | None:
        """The finding to look at first, or None."""
        return self.findings[0] if self.findings else None

    @property
    def sentence(self) -> str:
        """What is the matter, in one plain sentence."""
        return FREE if self.worst is None else self.worst.sentence

    @property
    def depth(self) -> float:
        """Deepest penetration in metres."""
        kinds = ("collision", "jammed", "combination")
        return max((f.depth for f in self.findings if f.kind in kinds), default=0.0)

    @property
    def place(self) -> tuple[int, float, str]:
        """Sorts the joints of an object, worst first."""
        return -VERDICTS.index(self.verdict), -self.depth, self.joint


@dataclass(frozen=True)
class GateReport:
    """How an articulated object stands.

    Attributes:
        joints: worst first.
        diagonal: of the object in metres; depths are read against it.
        physics: what the simulator said; None where it wasn't asked.
        seconds: how long it took.
    """

    joints: tuple[JointVerdict, ...]
    diagonal: float
    physics: PhysicsReport | None = None
    seconds: float = 0.0

    @property
    def verdict(self) -> Verdict:
        """The worst of the joints."""
        return worst_of(j.verdict for j in self.joints)

    def of(self, joint: str) -> JointVerdict | None:
        """The verdict of a joint, or None."""
        return next((j for j in self.joints if j.joint == joint), None)

    def with_verdict(self, verdict: Verdict) -> tuple[JointVerdict, ...]:
        """The joints that stand so."""
        return tuple(j for j in self.joints if j.verdict == verdict)

    def to_json(self) -> dict[str, Any]:
        """For a provenance record: plain values, no mends."""
        return {
            "verdict": self.verdict,
            "joints": [_joint_json(j, self.diagonal) for j in self.joints],
            "physics": None if self.physics is None else self.physics.to_json(),
        }


def _joint_json(joint: JointVerdict, diagonal: float) -> dict[str, Any]:
    return {
        "joint": joint.joint,
        "child": joint.child,
        "verdict": joint.verdict,
        "sentence": joint.sentence,
        "depth": round(joint.depth, 6),
        "depth_share": round(joint.depth / max(diagonal, 1e-12), 6),
        "findings": [
            {"kind": f.kind, "verdict": f.verdict, "sentence": f.sentence} for f in joint.findings
        ],
    }
