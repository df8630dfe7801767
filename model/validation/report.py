"""The validation report: findings and fixes of each joint, worst first.

With it goes the result of driving the joints in a simulator.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any, Literal

from model.core.joint import Joint
from model.validation.messages import MOVES_FREELY


@dataclass(frozen=True)
class Stop:
    """State of a driven joint that stopped short, or left its limits.

    Attributes:
        q: its joint value there.
        other: the link whose shapes it touches, or None.
        where: (3,) that contact, object frame; None without one.
    """

    q: Mapping[str, float]
    other: str | None = None
    where: tuple[float, float, float] | None = None


@dataclass(frozen=True)
class PhysicsReport:
    """Each joint driven there and back in a simulator, without gravity and with it.

    Attributes:
        ran: whether it ran; False where no simulator is installed, or none could load the object.
        problem: why it didn't run, or "".
        exploded: joint → readable cause (not a number, far outside the limits).
        drifted: joint → share of its range by which it moved while others were driven.
        missed: joint → share of its range that it fell short of its target.
        shapes: number of collision shapes; 0 where masses and joints were driven alone.
        seconds: simulated.
        stops: joint → where it stopped or left its limits.
        engine: display name.
    """

    ran: bool
    problem: str = ""
    exploded: Mapping[str, str] = field(default_factory=dict)
    drifted: Mapping[str, float] = field(default_factory=dict)
    missed: Mapping[str, float] = field(default_factory=dict)
    shapes: int = 0
    seconds: float = 0.0
    stops: Mapping[str, Stop] = field(default_factory=dict)
    engine: str = "MuJoCo"

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "engine": self.engine,
            "ran": self.ran,
            "problem": self.problem,
            "exploded": dict(self.exploded),
            "drifted": {k: round(v, 4) for k, v in self.drifted.items()},
            "missed": {k: round(v, 4) for k, v in self.missed.items()},
            "shapes": self.shapes,
            "seconds": round(self.seconds, 3),
        }


class Severity(StrEnum):
    """Severity of a finding; the values are the words that provenance.json and caches hold."""

    OK = "fine"
    WARNING = "look"
    ERROR = "broken"

    @property
    def rank(self) -> int:
        """0 for OK, 1 for a warning, 2 for an error."""
        return _RANKS[self]


_RANKS = {severity: k for k, severity in enumerate(Severity)}

Kind = Literal[
    "geometry", "jammed", "floating", "limits", "collision", "detached", "physics", "combination",
    "siblings", "size", "unsure", "name",
]  # fmt: skip
"""Checks, in the order of equally bad findings; "unsure" is the written name of a low
confidence."""
KINDS: tuple[Kind, ...] = Kind.__args__  # type: ignore[attr-defined]
FixKind = Literal["like", "flip", "shift", "limits", "shrink", "size"]


@dataclass(frozen=True)
class Finding:
    """One result of a check.

    Attributes:
        kind: the check. severity: of the finding. message: human-readable.
        depth: metres: of a collision, or of the gap between a part and its support.
        q: joint values at the worst pose; joints that are left out are at 0.
        where: (3,) the contact at that pose, object frame; None without one.
        other: the other link, or None.
        engine: display name of the one that found it; "" where none did.
    """

    kind: Kind
    severity: Severity
    message: str
    depth: float = 0.0
    q: Mapping[str, float] = field(default_factory=dict)
    where: tuple[float, float, float] | None = None
    other: str | None = None
    engine: str = ""


def worst_first(findings: Iterable[Finding]) -> tuple[Finding, ...]:
    """Sort by severity, then by kind."""
    return tuple(sorted(findings, key=lambda f: (-f.severity.rank, KINDS.index(f.kind))))


@dataclass(frozen=True)
class Fix:
    """A change after which validation no longer finds what the fix is for.

    Attributes:
        kind: move like an equal part, flip the direction, shift the axis, set the limits, shrink
            the collision shapes, or change the object's size.
        joint: takes the place of its child's joint; None where the object is resized.
        message: human-readable.
        value: the part or the size that the fix is named after, human-readable; else "".
        scale: of the object's new size over its present one.
    """

    kind: FixKind
    joint: Joint | None
    message: str
    value: str = ""
    scale: float = 1.0


@dataclass(frozen=True)
class JointReport:
    """The findings about one joint.

    Attributes:
        joint: its name. child: the link that it moves.
        findings: worst first; a joint without any moves freely.
        fixes: best first. Each was tried out, but for shrinking, which works by construction.
    """

    joint: str
    child: str
    findings: tuple[Finding, ...] = ()
    fixes: tuple[Fix, ...] = ()

    @property
    def severity(self) -> Severity:
        """The worst of the findings."""
        return _worst(f.severity for f in self.findings)

    @property
    def worst(self) -> Finding | None:
        """The first finding, or None."""
        return self.findings[0] if self.findings else None

    @property
    def message(self) -> str:
        """The message of the worst finding."""
        return MOVES_FREELY if self.worst is None else self.worst.message

    @property
    def depth(self) -> float:
        """Deepest penetration in metres."""
        kinds = ("collision", "jammed", "combination")
        return max((f.depth for f in self.findings if f.kind in kinds), default=0.0)

    @property
    def sort_key(self) -> tuple[int, float, str]:
        """Sorts the joints of an object, worst first."""
        return -self.severity.rank, -self.depth, self.joint


@dataclass(frozen=True)
class ValidationReport:
    """The findings about an articulated object.

    Attributes:
        joints: worst first.
        diagonal: of the object in metres; depths are read against it.
        physics: the result of the simulation; None where it was left out.
        seconds: how long validation took.
        others: results of further engines.
    """

    joints: tuple[JointReport, ...]
    diagonal: float
    physics: PhysicsReport | None = None
    seconds: float = 0.0
    others: tuple[PhysicsReport, ...] = ()

    def executable_in(self, run: PhysicsReport) -> bool:
        """True if an engine ran, and no joint has an error that it or the checks found."""
        return run.ran and not any(
            f.severity == Severity.ERROR and f.engine in ("", run.engine)
            for j in self.joints
            for f in j.findings
        )

    @property
    def severity(self) -> Severity:
        """The worst of the joints."""
        return _worst(j.severity for j in self.joints)

    def of(self, joint: str) -> JointReport | None:
        """The report of a joint, or None."""
        return next((j for j in self.joints if j.joint == joint), None)

    def joints_with(self, severity: Severity) -> tuple[JointReport, ...]:
        """The joints of this severity."""
        return tuple(j for j in self.joints if j.severity == severity)

    def to_json(self) -> dict[str, Any]:
        """Plain values for provenance.json, without fixes."""
        return {
            "verdict": self.severity.value,
            "joints": [_joint_json(j, self.diagonal) for j in self.joints],
            "physics": None if self.physics is None else self.physics.to_json(),
            **({"others": [run.to_json() for run in self.others]} if self.others else {}),
        }


def _worst(severities: Iterable[Severity]) -> Severity:
    return max(severities, key=lambda s: s.rank, default=Severity.OK)


def _joint_json(joint: JointReport, diagonal: float) -> dict[str, Any]:
    return {
        "joint": joint.joint,
        "child": joint.child,
        "verdict": joint.severity.value,
        "sentence": joint.message,
        "depth": round(joint.depth, 6),
        "depth_share": round(joint.depth / max(diagonal, 1e-12), 6),
        "findings": [
            {"kind": f.kind, "verdict": f.severity.value, "sentence": f.message}
            for f in joint.findings
        ],
    }
