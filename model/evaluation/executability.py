"""Whether a predicted object works: every joint over its range, alone, together, and in MuJoCo.

The findings of :mod:`model.validation` become figures of an object: penetration, parts that come
off, jam or float, impossible limits, and in the simulator values that are no numbers, explode,
drift or stop short. An object is executable where validation finds no error.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec

from model.core.articulated_object import ArticulatedObject
from model.core.errors import ConfigurationError
from model.core.installing import install_command
from model.evaluation.pool import OutOfTimeError, time_limit
from model.validation.report import Severity
from model.validation.runner import validate

MOST = 6
"""Findings that are listed of one object."""


@dataclass(frozen=True)
class Execution:
    """The result of one object.

    Attributes:
        executable: no errors, and the simulator ran.
        why: errors and warnings, for people; "" where all joints move freely.
        kinds: kinds of the errors, see :data:`model.validation.report.Kind`.
        depth: deepest penetration over the object's diagonal.
        drift: largest share of a joint's range by which it moved while others were driven.
        missed: largest share of a range that a driven joint fell short of.
        joints, broken: number of moving joints, and of those with errors.
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
    """Check early that MuJoCo is installed.

    Raises:
        ConfigurationError: where it isn't.
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
        timeout: seconds, after which the object counts as not executable.
    """
    if obj is None:
        return Execution(False, "there is no prediction")
    try:
        with time_limit(timeout):
            return _validated(obj, seed)
    except OutOfTimeError as error:
        return Execution(False, f"driving its joints was {error}")
    except Exception as error:  # the boundary: any geometry may come here
        return Execution(False, f"{type(error).__name__}: {error}"[:300])


def _validated(obj: ArticulatedObject, seed: int) -> Execution:
    report = validate(obj, seed=seed, physics=True, shapes=False, fixes=False)
    bad = report.joints_with(Severity.ERROR)
    said = [f"{v.child}: {v.message}" for v in report.joints if v.severity != Severity.OK]
    kinds = {f.kind for v in bad for f in v.findings if f.severity == Severity.ERROR}
    physics = report.physics
    ran = physics is not None and physics.ran
    if not ran and not bad:
        said.insert(0, physics.problem if physics is not None else "the simulator didn't run")
    return Execution(
        executable=not bad and ran,
        why="; ".join(said[:MOST]) + ("; …" if len(said) > MOST else ""),
        kinds=tuple(sorted(kinds)),
        depth=max((v.depth for v in report.joints), default=0.0) / (report.diagonal or 1.0),
        drift=max(physics.drifted.values(), default=0.0) if physics is not None else 0.0,
        missed=max(physics.missed.values(), default=0.0) if physics is not None else 0.0,
        joints=sum(j.moves for j in obj.tree.joints),
        broken=len(bad),
    )
