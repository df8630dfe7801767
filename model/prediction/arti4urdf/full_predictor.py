"""The paper-size model as a predictor: ``qwen3:FOLDER`` of :mod:`model.prediction.registry`."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import lru_cache
from pathlib import Path

import torch
from torch import Tensor

from model.core.articulated_object import ArticulatedObject, Prediction, SegmentedObject
from model.core.errors import ConfigurationError, KinematicsError
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.core.tree import KinematicTree
from model.prediction.arti4urdf.answer import parse_answer
from model.prediction.arti4urdf.full_model import LANGUAGE, FullModel, load_full_model
from model.prediction.arti4urdf.published_weights import load_qwen3
from model.prediction.arti4urdf.text_engine import LocalEngine, TextEngine, VllmEngine
from model.prediction.arti4urdf.text_prompt import make_example
from model.prediction.arti4urdf.text_script import AnswerScript

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
        """See :class:`model.prediction.protocol.Predictor`; the seed is that of the points."""
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
