"""Figures of many objects: every metric in one table, with its definition, unit and source.

Each metric is a ratio of two sums over objects, so the same table serves means, categories,
bootstrap intervals and comparisons of runs. Beside them stands the calibration of the confidence.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.joint import JOINT_KINDS
from model.evaluation.joint_metrics import WORST_ANGLE, WORST_DISTANCE, JointScore, ObjectScore

S2O_AXIS = math.radians(5.0)
"""Largest axis error of a hit (rad), as S2O's code has it."""
S2O_ORIGIN = 0.1
"""Largest origin error of a hit, in the moving part's diagonals."""

Terms = Callable[[ObjectScore], tuple[float, float]]


@dataclass(frozen=True)
class Metric:
    """One figure.

    Attributes:
        key: its name in JSON.
        label: heading of a column.
        unit: "%" (a share, 0..1 in JSON), "rad", "m", "diagonals", "edits" or "" (0..1).
        higher: whether more is better.
        definition, source: human-readable.
        terms: what an object adds to the two sums whose ratio it is.
    """

    key: str
    label: str
    unit: str
    higher: bool
    definition: str
    source: str
    terms: Terms


def _over_joints(value: Callable[[JointScore], float | bool | None]) -> Terms:
    """Mean of ``value`` over the true joints that have one."""

    def terms(score: ObjectScore) -> tuple[float, float]:
        kept = [float(v) for j in score.joints if (v := value(j)) is not None]
        return sum(kept), float(len(kept))

    return terms


def _over_objects(value: Callable[[ObjectScore], float | bool | None]) -> Terms:
    """Mean of ``value`` over the objects that have one."""

    def terms(score: ObjectScore) -> tuple[float, float]:
        found = value(score)
        return (0.0, 0.0) if found is None else (float(found), 1.0)

    return terms


def _predicted(score: ObjectScore) -> int:
    """Moving joints of a prediction; one that can't be read is one too."""
    return len(score.extra) + sum(j.type != "missing" for j in score.joints)


def _hits(score: ObjectScore, level: str) -> int:
    """True joints that S2O would call found: same motion (M), also axis (MA), also origin (MAO)."""
    out = 0
    for j in score.joints:
        if not j.present or JOINT_KINDS[j.type].slides != JOINT_KINDS[j.true_type].slides:
            continue
        axis = "A" not in level or (j.apd is not None and j.apd < S2O_AXIS)
        origin = "O" not in level or j.opd_part is None or j.opd_part < S2O_ORIGIN
        out += axis and origin
    return out


def _s2o(level: str, figure: str) -> Terms:
    def terms(score: ObjectScore) -> tuple[float, float]:
        hits, true, found = _hits(score, level), len(score.joints), _predicted(score)
        pairs = {"precision": (hits, found), "recall": (hits, true), "f1": (2 * hits, true + found)}
        a, b = pairs[figure]
        return float(a), float(b)

    return terms


def _with_missing(
    value: Callable[[JointScore], float | None], worst: float, score: ObjectScore
) -> tuple[float, float]:
    turning = [j for j in score.joints if j.rotates]
    errors = [worst if (v := value(j)) is None else v for j in turning]
    return sum(errors), float(len(errors))


def _limits_with_missing(rotating: bool) -> Terms:
    """Limit errors where a joint that is missing or of another type counts as one that is still."""

    def terms(score: ObjectScore) -> tuple[float, float]:
        kept = [j for j in score.joints if j.still is not None and j.rotates == rotating]
        found = [j.ald if rotating else j.dld for j in kept]
        errors = [j.still or 0.0 if v is None else v for j, v in zip(kept, found, strict=True)]
        return sum(errors), float(len(errors))

    return terms


def _driven(score: ObjectScore) -> tuple[float, float]:
    run = score.execution
    return (0.0, 0.0) if run is None else (float(run.joints - run.broken), float(run.joints))


_PAPER, _S2O, _OURS = "ArtiWorld (CVPR 2026)", "S2O (Iliash et al., 2024)", "ArtiWorld's evaluator"
_MOTIONS = (
    ("m", "M", "the motion is right (turning or sliding)"),
    ("ma", "MA", "motion right and axis within 5 degrees"),
    ("mao", "MAO", "motion, axis, and origin within 0.1 of the part's diagonal from the true line"),
)

METRICS: tuple[Metric, ...] = (
    Metric("tc", "TC %", "%", True, "share of true joints whose type is right; a missing joint is "
           "wrong", _PAPER, _over_joints(lambda j: j.type_right)),
    Metric("apd", "APD", "rad", False, "angle between the axis lines, 0..pi/2, of joints that have "
           "a prediction", _PAPER, _over_joints(lambda j: j.apd)),
    Metric("opd", "OPD", "m", False, "distance between the origins, joints that turn in both",
           _PAPER, _over_joints(lambda j: j.opd)),
    Metric("ald", "ALD", "rad", False, "mean error of the two limits, revolute in both, the "
           "predicted axis turned to the true side", _PAPER, _over_joints(lambda j: j.ald)),
    Metric("dld", "DLD", "m", False, "mean error of the two limits, prismatic in both", _PAPER,
           _over_joints(lambda j: j.dld)),
    Metric("usable", "usable %", "%", True, "share of objects whose joints are all usable, none "
           "missing and none extra", _PAPER, _over_objects(lambda o: o.usable)),
    Metric("tree", "tree %", "%", True, "share of objects whose parts all have their true parent",
           _OURS, _over_objects(lambda o: o.tree_right)),
    Metric("opd_line", "OPD line/diag", "diagonals", False, "distance of the predicted origin to "
           "the true axis line over the object's diagonal, joints that turn in both", _S2O,
           _over_joints(lambda j: j.opd_line)),
    Metric("usable_joints", "usable joints %", "%", True, "share of usable true joints", _OURS,
           _over_joints(lambda j: j.usable)),
    Metric("type_precision", "type precision %", "%", True, "share of predicted moving joints "
           "whose type is right", _OURS,
           lambda o: (float(sum(j.type_right for j in o.joints)), float(_predicted(o)))),
    Metric("parent", "parent %", "%", True, "share of true joints below the right part", _OURS,
           _over_joints(lambda j: j.parent_right)),
    Metric("range_right", "range %", "%", True, "share of true joints with a usable range", _OURS,
           _over_joints(lambda j: j.range_right)),
    Metric("range_iou", "range overlap", "", True, "intersection over union of the two ranges, "
           "limited in both and of one type", _OURS, _over_joints(lambda j: j.range_iou)),
    Metric("tree_edits", "tree edits", "edits", False, "tree edit distance: parts on a wrong "
           "parent, missing or extra, a mean over objects", "Zhang and Shasha (1989), known nodes",
           _over_objects(lambda o: o.tree_edits)),
    Metric("part_iou", "part IoU", "", True, "IoU of a true part's surface with its match, 0 "
           "without one; a mean over objects of the mean over parts, only where parts had to be "
           "found", _S2O, _over_objects(lambda o: o.part_iou)),
    Metric("parts_found", "parts %", "%", True, "share of true parts that were matched", _S2O,
           lambda o: (float(o.matched), float(o.parts))),
    Metric("apd_all", "APD with missing", "rad", False, "APD with missing joints at pi/2", _OURS,
           _over_joints(lambda j: WORST_ANGLE if j.apd is None else j.apd)),
    Metric("opd_all", "OPD with missing", "m", False, "OPD with missing joints, and joints that "
           "should turn and don't, at the object's diagonal", _OURS,
           lambda o: _with_missing(lambda j: j.opd, o.diagonal, o)),
    Metric("opd_line_all", "OPD line with missing", "diagonals", False, "the same of OPD "
           "line/diag, at 1", _OURS,
           lambda o: _with_missing(lambda j: j.opd_line, WORST_DISTANCE, o)),
    Metric("ald_all", "ALD with missing", "rad", False, "ALD over all revolute joints; one that is "
           "missing or of another type counts as one that stands still", _OURS,
           _limits_with_missing(True)),
    Metric("dld_all", "DLD with missing", "m", False, "the same of DLD, prismatic joints", _OURS,
           _limits_with_missing(False)),
    Metric("executable", "executable %", "%", True, "share of objects whose joints all move over "
           "their range, alone and together, with nothing broken, in every engine that was asked "
           "for (MuJoCo by default)", _OURS,
           _over_objects(lambda o: None if o.execution is None else o.execution.executable)),
    *(
        Metric(f"executable_{engine}", f"executable in {title} %", "%", True,
               f"the same in {title} alone", _OURS,
               _over_objects(lambda o, name=engine: o.execution and o.execution.engines.get(name)))
        for engine, title in (("mujoco", "MuJoCo"), ("sapien", "SAPIEN"))
    ),
    Metric("joints_executable", "joints executable %", "%", True, "share of predicted moving "
           "joints that aren't broken when they are driven", _OURS, _driven),
    Metric("penetration", "penetration", "diagonals", False, "deepest penetration beyond that at "
           "rest while the joints are driven, a mean over objects", _OURS,
           _over_objects(lambda o: None if o.execution is None else o.execution.depth)),
    Metric("drift", "drift", "", False, "largest share of its range by which a joint moves in "
           "an engine while others are driven, a mean over objects", _OURS,
           _over_objects(lambda o: None if o.execution is None else o.execution.drift)),
    *(
        Metric(f"{key}_{figure}", f"{name} {figure} %", "%", True, f"{figure} of joints where "
               f"{text}", _S2O, _s2o(name, figure))
        for key, name, text in _MOTIONS for figure in ("precision", "recall", "f1")
    ),
)  # fmt: skip
"""Every figure, in the order of the reports."""


@dataclass(frozen=True)
class Summary:
    """Figures of many objects: see :data:`METRICS` for what each one is.

    Attributes:
        objects, joints: how many were scored.
        missing, unparseable, extra: joints that aren't there, can't be read, shouldn't be.
        failed: objects without a prediction.
        values: the figures of :data:`METRICS` by key; NaN where nothing was there to average.
    """

    objects: int
    joints: int
    missing: int
    unparseable: int
    extra: int
    failed: int
    values: Mapping[str, float]

    def __getitem__(self, key: str) -> float:
        return self.values[key]


def summarise(scores: Iterable[ObjectScore]) -> Summary:
    """Average over objects and joints."""
    objects = list(scores)
    joints = [j for o in objects for j in o.joints]
    sums = term_sums(objects).sum(axis=0) if objects else np.zeros((len(METRICS), 2))
    return Summary(
        objects=len(objects),
        joints=len(joints),
        missing=sum(j.type == "missing" for j in joints),
        unparseable=sum(j.type == "unparseable" for j in joints),
        extra=sum(len(o.extra) for o in objects),
        failed=sum(bool(o.problem) for o in objects),
        values={m.key: _ratio(*sums[i]) for i, m in enumerate(METRICS)},
    )


def term_sums(objects: Sequence[ObjectScore]) -> npt.NDArray[np.float64]:
    """(N, M, 2) numerator and denominator of each object in each of :data:`METRICS`."""
    return np.array([[m.terms(o) for m in METRICS] for o in objects]).reshape(-1, len(METRICS), 2)


RESAMPLES = 2000
Interval = tuple[float, float]


def bootstrap(objects: Sequence[ObjectScore], *, seed: int = 0) -> dict[str, Interval]:
    """95 % percentile intervals of every metric, objects drawn with replacement (Efron, 1979).

    Returns:
        key → lower and upper end; NaN where a metric has no value.
    """
    if not objects:
        return {m.key: (math.nan, math.nan) for m in METRICS}
    return intervals(resampled(term_sums(objects), seed=seed, resamples=RESAMPLES))


def intervals(drawn: npt.NDArray[np.float64]) -> dict[str, Interval]:
    """Key → 95 % percentile interval of (resamples, M) figures or their differences."""
    out = {}
    for i, metric in enumerate(METRICS):
        values = drawn[:, i][np.isfinite(drawn[:, i])]
        low, high = np.percentile(values, (2.5, 97.5)) if len(values) else (np.nan, np.nan)
        out[metric.key] = (float(low), float(high))
    return out


def resampled(
    terms: npt.NDArray[np.float64], *, seed: int, resamples: int
) -> npt.NDArray[np.float64]:
    """(resamples, M) figures of objects drawn with replacement from (N, M, 2) terms."""
    count = len(terms)
    rng = np.random.default_rng(seed)
    times = rng.multinomial(count, np.full(count, 1 / count), size=resamples).astype(np.float64)
    sums = np.einsum("rn,nmk->rmk", times, terms)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(sums[..., 1] > 0, sums[..., 0] / sums[..., 1], np.nan)


def _ratio(a: float, b: float) -> float:
    return float(a / b) if b > 0 else math.nan


BINS = 10


@dataclass(frozen=True)
class CalibrationBin:
    """Joints of similar confidence.

    Attributes:
        low, high: of the bin, 0..1. joints: in it.
        confidence: their mean. usable: share of usable joints.
    """

    low: float
    high: float
    joints: int
    confidence: float
    usable: float


@dataclass(frozen=True)
class Calibration:
    """Reliability of a predictor (Guo et al., *On Calibration*, 2017).

    Attributes:
        bins: those that hold a joint.
        joints: with a confidence.
        ece: expected calibration error, the mean gap between confidence and the share of usable
            joints, weighted by the joints of each bin; NaN without any.
        brier: mean squared gap between confidence and usable (1) or not (0).
    """

    bins: tuple[CalibrationBin, ...]
    joints: int
    ece: float
    brier: float


def calibrate(scores: Iterable[ObjectScore], *, bins: int = BINS) -> Calibration:
    """Compare confidences with the joints' usability; extra joints are left out."""
    pairs = [
        (j.confidence, float(j.usable))
        for o in scores
        for j in o.joints
        if j.present and j.confidence is not None
    ]
    if not pairs:
        return Calibration((), 0, math.nan, math.nan)
    confidence, right = np.array(pairs).T
    return compared(confidence, right, bins=bins)


def compared(
    confidence: npt.NDArray[np.floating],
    right: npt.NDArray[np.floating],
    weights: npt.NDArray[np.floating] | None = None,
    *,
    bins: int = BINS,
) -> Calibration:
    """Compare (N,) confidences with (N,) outcomes, 1 or 0, with optional ``weights`` (N,)."""
    weights = np.ones(len(confidence)) if weights is None else weights
    place = np.minimum((confidence * bins).astype(int), bins - 1)
    found, ece = [], 0.0
    for k in np.unique(place):
        here = place == k
        mean, usable = (
            float(np.average(values[here], weights=weights[here])) for values in (confidence, right)
        )
        found.append(
            CalibrationBin(float(k / bins), float((k + 1) / bins), int(here.sum()), mean, usable)
        )
        ece += float(weights[here].sum()) * abs(mean - usable)
    brier = float(np.average((confidence - right) ** 2, weights=weights))
    return Calibration(tuple(found), len(confidence), ece / float(weights.sum()), brier)
