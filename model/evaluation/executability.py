"""Executability of a predicted object: each joint over its range, alone, together, in an engine.

The findings of :mod:`model.validation` become figures of an object: penetration, parts that come
off, jam or float, impossible limits, and in the simulator values that are no numbers, explode,
drift or stop short. An object is executable where validation finds no error.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from model.core.articulated_object import ArticulatedObject
from model.evaluation.pool import OutOfTimeError, time_limit
from model.validation.engines import MUJOCO
from model.validation.report import Severity, ValidationReport
from model.validation.runner import validate

MOST = 6
"""Findings that are listed of one object."""


@dataclass(frozen=True)
class Execution:
    """The result of one object.

    Attributes:
        executable: no errors, and the simulator ran.
        why: human-readable errors and warnings; "" where all joints move freely.
        kinds: kinds of the errors, see :data:`model.validation.report.Kind`.
        depth: deepest penetration over the object's diagonal.
        drift: largest share of a joint's range by which it moved while others were driven.
        missed: largest share of a range that a driven joint fell short of.
        joints, broken: number of moving joints, and of those with errors.
        engines: engine → whether the object is executable there; empty in reports before them.
    """

    executable: bool
    why: str
    kinds: tuple[str, ...] = ()
    depth: float = 0.0
    drift: float = 0.0
    missed: float = 0.0
    joints: int = 0
    broken: int = 0
    engines: Mapping[str, bool] = field(default_factory=dict)


def execute(
    obj: ArticulatedObject | None,
    *,
    seed: int = 0,
    timeout: float = 120.0,
    engines: Sequence[str] = (MUJOCO,),
    shapes: bool = False,
    store: Path | None = None,
) -> Execution:
    """Drive all joints of ``obj``; never raises but for a lack of memory.

    Args:
        obj: None where there is no prediction: not executable.
        seed: random seed of the combinations.
        timeout: seconds, after which the object counts as not executable.
        engines: names; the object is executable where it is so in all.
        shapes: whether its collision shapes take part. store: folder that keeps them.
    """
    nowhere = dict.fromkeys(engines, False)
    if obj is None:
        return Execution(False, "there is no prediction", engines=nowhere)
    try:
        with time_limit(timeout):
            report = validate(
                obj, seed=seed, shapes=shapes, store=store, fixes=False, engines=engines
            )
            return _execution(obj, report, engines)
    except OutOfTimeError as error:
        return Execution(False, f"driving its joints was {error}", engines=nowhere)
    except Exception as error:  # the boundary: any geometry may come here
        return Execution(False, f"{type(error).__name__}: {error}"[:300], engines=nowhere)


def _execution(
    obj: ArticulatedObject, report: ValidationReport, engines: Sequence[str]
) -> Execution:
    bad = report.joints_with(Severity.ERROR)
    said = [f"{v.child}: {v.message}" for v in report.joints if v.severity != Severity.OK]
    kinds = {f.kind for v in bad for f in v.findings if f.severity == Severity.ERROR}
    runs = [run for run in (report.physics, *report.others) if run is not None]
    ran = bool(runs) and all(run.ran for run in runs)
    if not ran and not bad:
        problems = [run.problem for run in runs if run.problem]
        said.insert(0, "; ".join(problems) or "the simulator didn't run")
    works = dict(zip(engines, map(report.executable_in, runs), strict=False))
    return Execution(
        executable=not bad and ran,
        why="; ".join(said[:MOST]) + ("; …" if len(said) > MOST else ""),
        kinds=tuple(sorted(kinds)),
        depth=max((v.depth for v in report.joints), default=0.0) / (report.diagonal or 1.0),
        drift=max((v for run in runs for v in run.drifted.values()), default=0.0),
        missed=max((v for run in runs for v in run.missed.values()), default=0.0),
        joints=sum(j.moves for j in obj.tree.joints),
        broken=len(bad),
        engines={**dict.fromkeys(engines, False), **works},
    )
