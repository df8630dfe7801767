"""The prompt of the paper-size model: its text and its clouds.

Source: ArtiWorld (CVPR 2026), Arti4URDF: the object's name, the part files, the global token, the
part tokens in the files' order, and the parts' geometric relations in words (structure prompt).
"""

from __future__ import annotations

import re

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.core.articulated_object import Part, SegmentedObject
from model.geometry.sampling import sample_surface
from model.kinematics.contact import contacts
from model.prediction.arti4urdf.answer import JSON_END, JSON_START, URDF_END, URDF_START
from model.prediction.arti4urdf.full_model import GLOBAL, PART, Example

_SYSTEM = (
    "You are an expert in URDF and mechanical structure. From the shapes of an object's rigid "
    "parts you find the base link, the kinematic tree and the joints between the parts."
)
_TASK = (
    "Find the base link. Decide each part's parent and joint type (revolute, continuous, prismatic "
    "or fixed) from geometry, contact, symmetry and possible motion; insert helper links for "
    f"compound motions. Write the kinematic tree as JSON without numbers between {JSON_START} and "
    f"{JSON_END}, then the complete URDF between {URDF_START} and {URDF_END}. Metres and radians, "
    "+z is up, the object's rest pose is zero."
)
_GREY = 0.4
"""Colour of clouds without colours (ULIP-2's preprocessing)."""
_NAME_LENGTH = 60


def make_example(
    segmented: SegmentedObject, points: int, *, structure: bool = True, seed: int = 0
) -> Example:
    """The model's input for an object.

    Args:
        segmented: with or without names and category. points: of each cloud.
        structure: describe the parts' places and contacts. seed: random seed.
    """
    rng = np.random.default_rng(seed)
    clouds = [_sampled(part, points, rng) for part in segmented.parts]
    # Parts share the whole object's cloud by their squared extents.
    areas = np.array([max(float(np.linalg.norm(np.ptp(c[:, :3], axis=0))), 1e-9) for c in clouds])
    owner = rng.choice(len(clouds), points, p=areas**2 / (areas**2).sum())
    whole = np.stack([clouds[k][i] for i, k in enumerate(owner)])
    return Example(
        prompt_text(segmented, structure=structure),
        normalised(whole),
        torch.stack([normalised(cloud) for cloud in clouds]),
    )


def normalised(cloud: npt.NDArray[np.float64]) -> Tensor:
    """(N, 6) as in Point-BERT's training: centroid at 0, largest radius 1, colours 0..1."""
    out = cloud.copy()
    out[:, :3] -= out[:, :3].mean(0)
    out[:, :3] /= max(float(np.linalg.norm(out[:, :3], axis=1).max()), 1e-9)
    return torch.from_numpy(out.astype(np.float32))


def _sampled(part: Part, count: int, rng: np.random.Generator) -> npt.NDArray[np.float64]:
    """(count, 6) points in metres with their colours."""
    if part.mesh is not None and part.mesh.face_areas.sum() > 0:
        cloud, _ = sample_surface(part.mesh, count, rng)
    elif part.cloud is not None and len(part.cloud):
        chosen = rng.choice(len(part.cloud), count, replace=len(part.cloud) < count)
        cloud = part.cloud.take(chosen)
    else:
        assert part.mesh is not None  # a mesh without area has only vertices
        corners = part.mesh.vertices[rng.integers(0, len(part.mesh.vertices), count)]
        return np.column_stack([corners, np.full_like(corners, _GREY)])
    points = cloud.points.astype(np.float64)
    if cloud.colors is None:
        return np.column_stack([points, np.full_like(points, _GREY)])
    return np.column_stack([points, cloud.colors / 255.0])


def prompt_text(segmented: SegmentedObject, *, structure: bool = True) -> str:
    """The text of the prompt up to the answer, in Qwen3's chat format."""
    files = [f"{part.link}.obj" + _named(part.name) for part in segmented.parts]
    lines = [
        f"Object: {plain(segmented.category or '') or 'unknown'}",
        f"Whole shape: <g_start>{GLOBAL}<g_end>",
        "Parts: " + ", ".join(files),
        f"Part shapes: <p_start>{PART * len(segmented.parts)}<p_end>",
    ]
    if structure:
        lines += ["Structure in metres:", *structure_text(segmented)]
    user = "\n".join([*lines, _TASK])
    return (
        f"<|im_start|>system\n{_SYSTEM}<|im_end|>\n<|im_start|>user\n{user}<|im_end|>\n"
        "<|im_start|>assistant\n"
    )


def structure_text(segmented: SegmentedObject) -> list[str]:
    """A line for the place of each part and for each contact."""
    out = []
    for part in segmented.parts:
        low, high = part.bounds
        center, size = _numbers((low + high) / 2), _numbers(high - low)
        out.append(f"- {part.link}: centre ({center}), size ({size})")
    for contact in contacts(segmented.parts):
        text = f"- {contact.a} touches {contact.b}"
        if len(contact.points):
            line = contact.line
            text += (
                f" around ({_numbers(contact.centroid)}), along ({_numbers(line.direction)}) "
                f"over {line.length:.3f}"
            )
        out.append(text)
    return out


def plain(text: str) -> str:
    """User text without special tokens and line breaks."""
    return re.sub(r"[<>|\s]+", " ", text).strip()[:_NAME_LENGTH]


def _named(name: str | None) -> str:
    name = plain(name or "")
    return f" ({name})" if name else ""


def _numbers(values: npt.NDArray[np.float64]) -> str:
    return " ".join(f"{v + 0.0:.3f}" for v in values)
