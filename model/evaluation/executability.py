"""Whether a predicted object works: every joint over its range, alone, together, and in MuJoCo.

The gate (:mod:`model.validation`) does the looking; here its findings become figures of an object:
penetration, coming off, jamming, floating, senseless limits, and in the simulator what is no
number, explodes, drifts or stops short. An object is executable where nothing of it is broken.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError
from model.core.installing import install_command
from model.evaluation.pool import OutOfTimeError, time_limit

MOST = 6
"""Findings told of one object."""


@dataclass(frozen=True)
class Execution:
    """What became of one object.

    Attributes:
        executable: nothing of it is broken, and the simulator ran.
        why: what is broken, or worth a look, in words; "" where all moves freely.
        kinds: what was broken: collision, combination, jammed, detached, floating, limits,
            geometry, physics.
        depth: deepest penetration over the object's diagonal.
        drift: largest share of a joint's range by which it moved while others were driven.
        missed: largest share of a range that a driven joint fell short of.
        joints, broken: how many move, and how many of them are broken.
    """

    executable: bool
    why: str
    kinds: tuple[str, ...] = ()
    depth: float = 0.0
    drift: float = 0.0
    missed: float = 0.0
    joints: int = 0
    broken: int = 0


def require_simulator() -> None:
    """Say early that MuJoCo is needed.

    Raises:
        ConfigurationError: where it isn't installed.
    """
    if find_spec("mujoco") is None:
        raise ConfigurationError(
            "--execute needs MuJoCo, which isn't installed; "
            f"{install_command('artiworld[physics]')}"
        )


def execute(obj: ArticulatedObject | None, *, seed: int = 0, timeout: float = 120.0) -> Execution:
    """Drive all joints of ``obj``; never raises but for a lack of memory.

    Args:
        obj: None where there is no prediction: not executable.
        seed: of the random combinations.
        timeout: seconds after which it counts as not executable.
    """
    if obj is None:
        return Execution(False, "there is no prediction")
    try:
        with time_limit(timeout):
            return _judged(obj, seed)
    except OutOfTimeError as error:
        return Execution(False, f"driving its joints was {error}")
    except Exception as error:  # the boundary: any geometry may come here
        return Execution(False, f"{type(error).__name__}: {error}"[:300])


def _judged(obj: ArticulatedObject, seed: int) -> Execution:
    from model.validation.runner import run_gate

    report = run_gate(obj, seed=seed, physics=True, shapes=False, mends=False)
    broken = report.with_verdict("broken")
    said = [f"{v.child}: {v.sentence}" for v in report.joints if v.verdict != "fine"]
    kinds = {f.kind for v in broken for f in v.findings if f.verdict == "broken"}
    physics = report.physics
    ran = physics is not None and physics.ran
    if not ran and not broken:
        said.insert(0, physics.problem if physics is not None else "the simulator didn't run")
    return Execution(
        executable=not broken and ran,
        why="; ".join(said[:MOST]) + ("; …" if len(said) > MOST else ""),
        kinds=tuple(sorted(kinds)),
        depth=max((v.depth for v in report.joints), default=0.0) / (report.diagonal or 1.0),
        drift=max(physics.drifted.values(), default=0.0) if physics is not None else 0.0,
        missed=max(physics.missed.values(), default=0.0) if physics is not None else 0.0,
        joints=sum(j.moves for j in obj.tree.joints),
        broken=len(broken),
    )
