"""The result of driving the joints in a simulator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any


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
