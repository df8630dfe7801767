"""The paper-size model as a predictor, ``qwen3:FOLDER`` of :mod:`model.prediction.registry`.

Its prompt is text and clouds. Source: ArtiWorld (CVPR 2026), Arti4URDF: the object's name, the part
files, the global token, the part tokens in the files' order, and the parts' geometric relations in
words (structure prompt).
"""

from __future__ import annotations

import math
import re
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from model.core.articulated_object import ArticulatedObject, Part, Prediction, SegmentedObject
from model.core.errors import ConfigurationError, KinematicsError
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.geometry.sampling import sample_surface
from model.kinematics.contact import contacts
from model.prediction.arti4urdf.answer import (
    JSON_END,
    JSON_START,
    URDF_END,
    URDF_START,
    parse_answer,
)
from model.prediction.arti4urdf.checkpoints import load_qwen3
from model.prediction.arti4urdf.full_model import (
    GLOBAL,
    LANGUAGE,
    PART,
    Example,
    FullModel,
    load_full_model,
)
from model.prediction.arti4urdf.text_script import AnswerScript
from model.prediction.arti4urdf.text_writing import LocalEngine, TextEngine, VllmEngine

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


TOKENS_PER_PART = 400
MIN_TOKENS = 600
"""Length at which an answer without constraints is cut off."""


class FullPredictor:
    """Reads clouds and writes a URDF.

    Args:
        reader: encoder, adapters and word embeddings. engine: continues the prompt.
        name: display name.
    """

    def __init__(self, reader: FullModel, engine: TextEngine, name: str) -> None:
        self.name = name
        self._reader, self._engine = reader, engine

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.registry.Predictor`; the seed is that of the points."""
        start = time.perf_counter()
        progress(0.0, "Reading shapes")
        example = make_example(segmented, self._reader.encoder.config.points, seed=seed)
        prompt = self._reader.prompt_embeddings(example)
        text, likely, problems = self._answer(
            prompt,
            segmented,
            locked,
            lambda fraction, message: progress(0.1 + 0.9 * fraction, message),
        )
        tree, found = parse_answer(text)
        problems += found
        if tree is not None:
            tree = _fitted(tree, segmented, locked, problems)
        confidence = {} if tree is None else {j.child: likely(j.child) for j in tree.joints}
        confidence |= {j.child: 1.0 for j in locked if j.child in confidence}
        return Prediction(
            tree, tuple(problems), confidence, self.name, seed, time.perf_counter() - start, text
        )

    def _answer(
        self,
        prompt: Tensor,
        segmented: SegmentedObject,
        locked: tuple[Joint, ...],
        progress: Progress,
    ) -> tuple[str, Callable[[str], float], list[str]]:
        """The text, the probability of a link's joint in it, and problems."""
        if isinstance(self._engine, LocalEngine):
            written = self._engine.write(prompt, AnswerScript(segmented, locked), progress=progress)
            odds = written.log_probabilities
            return written.text, lambda link: math.exp(min(odds.get(link, 0.0), 0.0)), []
        most = MIN_TOKENS + TOKENS_PER_PART * len(segmented.parts)
        answer = self._engine.generate(prompt, max_tokens=most, progress=progress)
        problems = [] if answer.complete else [f"the answer was cut off after {most} tokens"]
        likely = math.exp(min(answer.log_probability, 0.0))
        return answer.text, lambda link: likely, problems


def _fitted(
    tree: KinematicTree, segmented: SegmentedObject, locked: tuple[Joint, ...], problems: list[str]
) -> KinematicTree | None:
    """The tree with the locked joints, or None if it doesn't fit the parts."""
    try:
        for joint in locked:
            tree = tree.with_joint(joint)
        return ArticulatedObject(segmented.name, segmented.parts, tree).tree
    except KinematicsError as error:
        problems += error.problems
        return None


def load_full_predictor(folder: Path, *, engine: str = "local") -> FullPredictor:
    """A predictor from a folder that :meth:`FullModel.save` wrote; on the GPU if there is one.

    Args:
        folder: of the weights.
        engine: "local" or "vllm".

    Raises:
        InputFileError: if the weights are absent or don't fit.
        ConfigurationError: for an unknown engine, or one that isn't installed.
    """
    if engine not in ("local", "vllm"):
        raise ConfigurationError(f"no engine {engine!r}; there are local, vllm")
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    dtype = torch.bfloat16 if device.type == "cuda" else torch.float32
    words = load_qwen3(folder / LANGUAGE, dtype=dtype)
    reader = load_full_model(folder, dtype=dtype, words=words.decoder.model.embed_tokens)
    reader.to(device)
    made: TextEngine
    if engine == "vllm":
        made = VllmEngine(folder / LANGUAGE, reader.end)
    else:
        made = LocalEngine(words.decoder.to(device), words.tokenizer, reader.end)
    return FullPredictor(reader.eval(), made, f"qwen3 {folder.name}")


@lru_cache(maxsize=1)  # gigabytes: a worker keeps them
def with_local_engine(folder: str) -> FullPredictor:
    """The paper-size model with ArtiWorld's own decoder."""
    return load_full_predictor(Path(folder))


@lru_cache(maxsize=1)
def with_vllm(folder: str) -> FullPredictor:
    """The paper-size model with vLLM."""
    return load_full_predictor(Path(folder), engine="vllm")
