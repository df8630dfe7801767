"""Predictions of other methods, folders of URDFs with meshes: read, aligned; the plain baseline.

A joint that can't be read becomes fixed, keeps its part, and counts against the method. A URDF or
mesh that can't be read at all is an object without a prediction.

Methods write URDFs Y up, in centimetres, or in a unit box. That is a convention and no mistake, so
it is resolved once: one rotation (of the 24 that map axes to axes) and one rule for the scale are
chosen for the whole method, by the distance of all its objects' surfaces from the true ones. With
the rule ``box`` each object has its own scale and position. The choice is reported. An object in
another frame than its method's others is wrong, and scored so.

In the plain baseline every part is hinged at the longest edge of its bounding box.
"""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal, get_args

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.core.articulated_object import ArticulatedObject, Part, Prediction, SegmentedObject
from model.core.errors import InputFileError
from model.core.geometry import affine
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.data.folders import urdf_files
from model.evaluation.part_matching import PartMatch, match_parts, sampled_parts
from model.io.merging import merge_rigid
from model.io.urdf.files import package_root
from model.io.urdf.meshes import load_part
from model.io.urdf.reader import read_urdf_model

Rule = Literal["as it is", "power of ten", "box"]
RULES: tuple[Rule, ...] = get_args(Rule)
"""Scale and position: unchanged, a power of ten, or fitted to the box's diagonal and centre."""
POINTS = 1500
CAP = 0.1
"""Largest distance that counts, in diagonals: a missing part must not decide the frame."""
MARGIN = 0.004
"""Smallest improvement of a less simple frame, in diagonals."""

FloatArray = npt.NDArray[np.float64]


def _rotations() -> tuple[npt.NDArray[np.float64], ...]:
    """The 24 proper signed permutations; the identity first, then Y up, then the rest."""
    found = []
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((1.0, -1.0), repeat=3):
            matrix = np.zeros((3, 3))
            matrix[range(3), order] = signs
            if np.linalg.det(matrix) > 0:
                found.append(matrix)
    y_up = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return tuple(sorted(found, key=lambda m: (-np.trace(m), not np.array_equal(m, y_up))))


ROTATIONS = _rotations()


@dataclass(frozen=True)
class Frame:
    """The transform of a method's files to the truth's frame.

    Attributes:
        rotation: index into :data:`ROTATIONS`.
        rule: for scale and position.
        exponent: of the power of ten.
    """

    rotation: int = 0
    rule: Rule = "as it is"
    exponent: int = 0

    def describe(self) -> str:
        """Describe rotation and scale, or "as it is"."""
        out = []
        if self.rotation:
            names = np.array(["x", "y", "z"])
            matrix = ROTATIONS[self.rotation]
            rows = [
                ("-" if row.sum() < 0 else "") + str(names[np.argmax(np.abs(row))])
                for row in matrix
            ]
            out.append(f"turned: its ({', '.join(rows)}) are x, y, z")
        if self.rule == "power of ten":
            out.append(f"scaled by {10.0**self.exponent:g}")
        elif self.rule == "box":
            out.append("each object scaled and moved to the true box")
        return "; ".join(out) or "as it is"


@dataclass(frozen=True, eq=False)
class Similarity:
    """``x ↦ scale · rotation · x + shift``, from the prediction's to the truth's frame."""

    rotation: FloatArray
    scale: float
    shift: FloatArray

    def points(self, points: FloatArray) -> FloatArray:
        """Transform (N, 3) points to the truth's frame."""
        return self.scale * points @ self.rotation.T + self.shift

    def object(self, obj: ArticulatedObject) -> ArticulatedObject:
        """Transform an object: geometry, axes, origins and limits."""
        return obj.moved(affine(self.scale * self.rotation, self.shift))


@dataclass(frozen=True)
class FrameCosts:
    """Distances of one object from the truth in each frame.

    Attributes:
        costs: (24, 3) as nested tuples, by rotation and :data:`RULES`: mean distance between the
            two surfaces in true diagonals, both ways.
        exponent: power of ten that fits its diagonal to the true one.
    """

    costs: tuple[tuple[float, ...], ...]
    exponent: int


def frame_costs(truth: FloatArray, predicted: FloatArray) -> FrameCosts:
    """Compare (N, 3) and (M, 3) samples of the two objects in every frame."""
    tree = KDTree(truth)
    diagonal = float(np.linalg.norm(np.ptp(truth, axis=0))) or 1.0
    own = float(np.linalg.norm(np.ptp(predicted, axis=0)))
    exponent = round(math.log10(diagonal / own)) if own > 0 else 0
    rows = []
    for rotation in range(len(ROTATIONS)):
        row = []
        for rule in RULES:
            if rule == "power of ten" and exponent == 0:
                row.append(row[0])
                continue
            similarity = fit(Frame(rotation, rule, exponent), truth, predicted)
            moved = similarity.points(predicted)
            there = np.minimum(tree.query(moved)[0] / diagonal, CAP).mean()
            back = np.minimum(KDTree(moved).query(truth)[0] / diagonal, CAP).mean()
            row.append(float(there + back) / 2)
        rows.append(tuple(row))
    return FrameCosts(tuple(rows), exponent)


def choose_frame(objects: Sequence[FrameCosts]) -> Frame:
    """Choose the best frame of a method's objects; the simplest one among equals."""
    if not objects:
        return Frame()
    costs = np.mean([o.costs for o in objects], axis=0)  # (24, 3)
    exponents = [o.exponent for o in objects]
    common = max(set(exponents), key=exponents.count)
    if exponents.count(common) < 0.8 * len(exponents):
        costs[:, 1] = np.inf  # no common power of ten
    simplicity = [(r, k) for k in range(len(RULES)) for r in range(len(ROTATIONS))]
    best = float(costs.min())
    rotation, rule = next((r, k) for r, k in simplicity if costs[r, k] <= best + MARGIN)
    if RULES[rule] == "power of ten":
        return Frame(rotation, "power of ten", common)
    return Frame(rotation, RULES[rule])


def fit(frame: Frame, truth: FloatArray, predicted: FloatArray) -> Similarity:
    """Fit the similarity of ``frame`` to one object, from (N, 3) and (M, 3) samples."""
    rotation = ROTATIONS[frame.rotation]
    if frame.rule == "as it is":
        return Similarity(rotation, 1.0, np.zeros(3))
    if frame.rule == "power of ten":
        return Similarity(rotation, 10.0**frame.exponent, np.zeros(3))
    turned = predicted @ rotation.T
    own = float(np.linalg.norm(np.ptp(turned, axis=0))) or 1.0
    scale = (float(np.linalg.norm(np.ptp(truth, axis=0))) or 1.0) / own
    middle = (truth.max(0) + truth.min(0)) / 2
    shift = middle - scale * (turned.max(0) + turned.min(0)) / 2
    return Similarity(rotation, scale, shift)


def outline(parts: Sequence[Part], points: int = POINTS) -> FloatArray:
    """Sample (N, 3) points of an object, the extreme points of its box among them."""
    sampled = sampled_parts(parts)
    everything = np.concatenate([s.points for s in sampled] or [np.zeros((1, 3))])
    order = np.random.default_rng(0).permutation(len(everything))[:points]
    corners = np.concatenate([_extremes(p) for p in parts])
    return np.concatenate([everything[order], _extremes_of(corners)])


def _extremes(part: Part) -> FloatArray:
    points = part.mesh.vertices[np.unique(part.mesh.faces)] if part.mesh is not None else None
    if points is None or not len(points):
        points = part.cloud.points if part.cloud is not None else part.bounds
    return _extremes_of(np.asarray(points, np.float64))


def _extremes_of(points: FloatArray) -> FloatArray:
    return points[np.unique(np.concatenate([points.argmin(0), points.argmax(0)]))]


def renamed(tree: KinematicTree, names: Mapping[str, str]) -> KinematicTree:
    """Rename links; links without a new name get a unique one."""
    taken = set(names.values())
    table = dict(names)
    for link in tree.links:
        if link not in table:
            new = f"unmatched:{link}"
            while new in taken:
                new += "_"
            table[link] = new
            taken.add(new)
    return tree.renamed(table)


PREDICTION_JSON = "prediction.json"


@dataclass(frozen=True, eq=False)
class WrittenPrediction:
    """One object as it was written, its rigid groups merged.

    Attributes:
        object: in the file's own frame.
        faulty: joints that couldn't be read; fixed in ``object``.
        swapped: joints whose lower limit is above the upper one; in order in ``object``.
        confidence: child link → 0..1, from a ``prediction.json`` beside the URDF.
        notes: what was changed on reading.
    """

    object: ArticulatedObject
    faulty: frozenset[str] = frozenset()
    swapped: frozenset[str] = frozenset()
    confidence: Mapping[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ResolvedPrediction:
    """A prediction with the truth's link names, in the truth's frame.

    Attributes:
        tree: links without a true part are named ``unmatched:…``.
        object: the same with its geometry.
        matches: the pairs of parts.
        faulty, swapped, confidence: as in :class:`WrittenPrediction`, true link names.
    """

    tree: KinematicTree
    object: ArticulatedObject
    matches: tuple[PartMatch, ...]
    faulty: frozenset[str]
    swapped: frozenset[str]
    confidence: Mapping[str, float]


@dataclass(frozen=True)
class PredictionFolder:
    """``<id>.urdf``, ``<id>/object.urdf``, ``<id>/mobility.urdf`` or the one URDF in ``<id>``."""

    root: Path

    def files(self) -> dict[str, Path]:
        """Object id → its URDF.

        Raises:
            InputFileError: where the folder isn't there or holds none.
        """
        if not Path(self.root).is_dir():
            raise InputFileError(self.root, "no such folder", "give a folder of URDFs")
        found = urdf_files(self.root)
        if not found:
            raise InputFileError(
                self.root, "no URDF in it", "write <id>.urdf or <id>/<any>.urdf for each object"
            )
        return found

    def read(self, object_id: str) -> WrittenPrediction:
        """Read one object.

        Raises:
            InputFileError: where there is none, or nothing of it can be read.
        """
        path = self.files().get(object_id)
        if path is None:
            raise InputFileError(Path(self.root) / object_id, "no prediction for this object")
        return read_prediction(path, self.root)


def read_prediction(path: Path, root: Path) -> WrittenPrediction:
    """Read one URDF; its meshes may lie anywhere below ``root``, or below the ROS package that
    holds it.

    Raises:
        InputFileError: where it is no URDF or a mesh can't be read.
    """
    package = package_root(path)  # the folder above that says so by its package.xml
    root = package if root.resolve().is_relative_to(package.resolve()) else root
    model = read_urdf_model(path, root=root, lenient=True)
    parts = {
        link: replace(load_part(link, visuals), name=None)
        for link, visuals in model.by_link.items()
    }
    if not parts:
        raise InputFileError(path, "no link has a mesh", "without any, no part can be matched")
    faulty = frozenset(model.faulty)
    obj, merges = merge_rigid(path.stem, model.tree, parts, apart=faulty)
    swapped = frozenset(model.swapped)
    confidence = _confidence(path.parent / PREDICTION_JSON)
    return WrittenPrediction(obj, faulty, swapped, confidence, (*model.notes, *merges))


def resolve(
    truth: ArticulatedObject, written: WrittenPrediction, frame: Frame
) -> ResolvedPrediction:
    """Transform a prediction to the truth's frame and match its parts."""
    similarity = fit(frame, outline(truth.parts), outline(written.object.parts))
    moved = similarity.object(written.object)
    matches = match_parts(sampled_parts(truth.parts), sampled_parts(moved.parts))
    names = {m.link: m.part for m in matches}
    tree = renamed(moved.tree, names)
    table = dict(zip(moved.tree.links, tree.links, strict=True))
    parts = tuple(replace(p, link=table[p.link]) for p in moved.parts)
    return ResolvedPrediction(
        tree,
        replace(moved, parts=parts, tree=tree),
        matches,
        written.faulty,
        written.swapped,
        {table[k]: v for k, v in written.confidence.items() if k in table},
    )


def outlines(
    truth: ArticulatedObject, written: WrittenPrediction
) -> Sequence[npt.NDArray[np.float64]]:
    """Samples of both, for :func:`model.evaluation.predictions.frame_costs`."""
    return outline(truth.parts), outline(written.object.parts)


def _confidence(path: Path) -> dict[str, float]:
    """Confidences of ArtiWorld's predictions; empty where the file is missing or unusable."""
    try:
        joints = json.loads(path.read_text(encoding="utf-8"))["joints"]
        found = {str(j["child"]): j.get("confidence") for j in joints}
    except (OSError, ValueError, KeyError, TypeError):
        return {}
    return {
        link: float(value)
        for link, value in found.items()
        if isinstance(value, int | float) and math.isfinite(value) and 0 <= value <= 1
    }


LONGEST_EDGE = "longest edge"
"""Its name among predictors of an evaluation."""


def longest_edge(segmented: SegmentedObject) -> Prediction:
    """The part with the largest box is the base; the others turn by a quarter about that of their
    four longest edges which is nearest to its middle. Nothing else is looked at."""
    base = max(segmented.parts, key=lambda p: float(np.prod(np.ptp(p.bounds, axis=0))))
    middle = base.bounds.mean(axis=0)
    joints = []
    for part in segmented.parts:
        if part is base:
            continue
        along = int(np.argmax(np.ptp(part.bounds, axis=0)))
        corners = [
            np.array([part.bounds[side, axis] for axis, side in enumerate(sides)], np.float64)
            for sides in itertools.product((0, 1), repeat=3)
            if not sides[along]
        ]
        x, y, z = min(corners, key=lambda corner: float(np.linalg.norm(corner - middle))).tolist()
        i, j, k = np.eye(3)[along].tolist()
        joints.append(Joint(
            f"joint_{part.link}", "revolute", base.link, part.link, (i, j, k), (x, y, z),
            0.0, math.pi / 2,
        ))  # fmt: skip
    links = tuple(p.link for p in segmented.parts)
    return Prediction(KinematicTree(links, tuple(joints)))
