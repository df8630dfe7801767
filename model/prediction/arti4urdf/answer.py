"""The answer as text and back: the only writer and parser of the paper's two blocks.

``<json_start>`` the kinematic tree without numbers ``<json_end>``, then ``<urdf_start>`` the whole
URDF ``<urdf_end>``. Bad text never raises: it becomes problems.
"""

from __future__ import annotations

import json
import re
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from model.core.articulated_object import ArticulatedObject, SegmentedObject
from model.core.errors import ArtiworldError, KinematicsError
from model.core.joint import Joint
from model.core.tree import KinematicTree
from model.io.tree_json import tree_json_problems, tree_to_json
from model.io.urdf.reader import read_urdf_model
from model.io.urdf.writer import to_urdf_text, vector
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.structure import Structure
from model.prediction.arti4urdf.vocabulary import FREE, Decision
from model.prediction.geometric.context import (
    Assembly,
    JointProposal,
    PartContext,
    joints_of,
    snapped,
    unit,
)
from model.prediction.geometric.limits import from_zero

Array = npt.NDArray[np.float64]

JSON_START, JSON_END = "<json_start>", "<json_end>"
URDF_START, URDF_END = "<urdf_start>", "<urdf_end>"
LONGEST = 4_000_000
"""Characters of an answer that are still read."""
LINE_REACH = 1.0
"""Largest offset (diagonals) of a free line from the part's centre, along each axis."""


def joints_of_decision(
    structure: Structure, part: int, decision: Decision, assembly: Assembly | None = None
) -> list[Joint]:
    """The joint of a decision (after its helper's, for a screw) in the object's frame.

    Args:
        structure: with the candidates. part: its index. decision: of the part, with a parent.
        assembly: with the decided tree: doors that are shut in it start at 0.
    """
    found = proposal_of(structure, part, decision)
    if assembly is not None:
        found = from_zero(PartContext(assembly, part), found)
    return joints_of(structure.sampled, part, decision.parent, found)


def proposal_of(structure: Structure, part: int, decision: Decision) -> JointProposal:
    """The joint of a decision in the working frame."""
    kind = v.TYPES[decision.type]
    shape = structure.sampled.shapes[part]
    if kind == "fixed":
        return JointProposal("fixed", np.array([0.0, 0.0, 1.0]), shape.center)
    if decision.slot == FREE:
        found = _free(structure, part, decision.numbers, kind)
    else:
        found = structure.candidate(part, decision.slot)
        assert found is not None
    if decision.type == v.SCREW:
        return replace(found, type="continuous", travel=_travel(structure, part, found, decision))
    lower, upper = (0.0, 0.0)
    if kind != "continuous":
        lower, upper = _limits(structure, part, found, decision)
    return replace(found, type=kind, lower=lower, upper=upper, travel=None)  # type: ignore[arg-type]


def _free(structure: Structure, part: int, numbers: list[int], kind: str) -> JointProposal:
    values = [v.level_coordinate(n, 1.0) for n in numbers]
    box = structure.sampled.shapes[part].box
    directions = np.concatenate([np.eye(3), box.axes.T])
    axis = snapped(unit(np.array(values[:3])), directions, 0.12)
    arm = np.array(values[3:]) * LINE_REACH
    joint_type = "prismatic" if kind == "prismatic" else "revolute"
    return JointProposal(joint_type, axis, structure.sampled.shapes[part].center + arm)


def _limits(
    structure: Structure, part: int, found: JointProposal, decision: Decision
) -> tuple[float, float]:
    rotates = v.TYPES[decision.type] == "revolute"
    if decision.lower >= 0:
        level = v.level_angle if rotates else v.level_travel
        lower, upper = level(decision.lower), level(decision.upper)
    else:
        lower, upper = found.lower, found.upper
    if upper - lower < 1e-3:
        reach = structure.sampled.shapes[part].box.reach(found.axis)
        lower, upper = (0.0, np.pi / 2) if rotates else (0.0, max(0.02, reach))
    return float(lower), float(upper)


def _travel(
    structure: Structure, part: int, found: JointProposal, decision: Decision
) -> tuple[float, float]:
    if decision.lower >= 0 and decision.upper > decision.lower:
        return v.level_travel(decision.lower), v.level_travel(decision.upper)
    if found.travel is not None:
        return found.travel
    return 0.0, max(0.02, 2 * structure.sampled.shapes[part].box.reach(found.axis))


DECIMALS = 5
"""Decimals of the numbers that a language model writes: a hundredth of a millimetre."""


def rounded(answer: str) -> str:
    """The answer with the numbers of its URDF rounded to :data:`DECIMALS`, for training."""

    def shorter(found: re.Match[str]) -> str:
        return found[1] + vector(np.round([float(x) for x in found[2].split()], DECIMALS)) + '"'

    return re.sub(r'(\b(?:xyz|lower|upper)=")([^"]*)"', shorter, answer)


def write_answer(tree: KinematicTree, segmented: SegmentedObject, mesh_suffix: str = ".obj") -> str:
    """The text of a tree: JSON without numbers, then the URDF with references to meshes."""
    obj = ArticulatedObject(segmented.name, segmented.parts, tree, segmented.category)
    meshes = {p.link: [f"meshes/{p.link}{mesh_suffix}"] for p in segmented.parts}
    body = json.dumps(tree_to_json(tree), indent=1)
    urdf = to_urdf_text(obj, meshes).strip()
    return f"{JSON_START}\n{body}\n{JSON_END}\n{URDF_START}\n{urdf}\n{URDF_END}\n"


def parse_answer(text: str) -> tuple[KinematicTree | None, tuple[str, ...]]:
    """Read an answer.

    Returns:
        The tree of the URDF block or None, and all problems, disagreements of the two blocks
        included. Never raises on bad text.
    """
    if len(text) > LONGEST:
        return None, (f"the answer has {len(text)} characters, more than {LONGEST}",)
    problems: list[str] = []
    body = _block(text, JSON_START, JSON_END, problems)
    urdf = _block(text, URDF_START, URDF_END, problems)
    if urdf is None:
        return None, tuple(problems)
    tree = _tree_of(urdf, problems)
    if tree is not None and body is not None:
        try:
            problems += tree_json_problems(body, tree)
        except RecursionError:
            problems.append("the JSON tree is nested too deeply")
    return tree, tuple(problems)


def _block(text: str, start: str, end: str, problems: list[str]) -> str | None:
    found = re.findall(re.escape(start) + r"(.*?)" + re.escape(end), text, flags=re.DOTALL)
    if not found:
        problems.append(f"the answer has no block between {start} and {end}")
        return None
    # The model's reasoning may quote the tags; the last block is the answer.
    return str(found[-1]).strip()


def _tree_of(urdf: str, problems: list[str]) -> KinematicTree | None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "answer.urdf"
        path.write_text(urdf, encoding="utf-8", errors="replace")
        try:
            model = read_urdf_model(path)
        except KinematicsError as error:
            problems.extend(error.problems)
            return None
        except ArtiworldError as error:
            problems.append(str(error).replace(str(path), "the URDF"))
            return None
    # A model writes axes with few decimals.
    problems.extend(n for n in model.notes if n not in model.rescaled)
    return model.tree
