"""Read the predictions of another method: a folder of URDFs with meshes.

A joint that can't be read becomes fixed, keeps its part, and counts against the method. A URDF or
mesh that can't be read at all is an object without a prediction.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject
from model.core.errors import InputFileError
from model.core.tree import KinematicTree
from model.data.urdf_folders import urdf_files
from model.evaluation.alignment import Frame, fit, outline, renamed
from model.evaluation.part_matching import PartMatch, match_parts, sampled_parts
from model.io.merging import merge_rigid
from model.io.urdf.files import package_root
from model.io.urdf.meshes import load_part
from model.io.urdf.reader import read_urdf_model

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
    """Samples of both, for :func:`model.evaluation.alignment.frame_costs`."""
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
