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
from model.prediction.arti4urdf.text_script import Author

TOKENS_PER_PART = 400
TOKENS_AT_LEAST = 600


class FullPredictor:
    """Reads clouds, writes URDF.

    Args:
        reader: encoder, adapters and word embeddings.
        engine: continues the prompt.
        name: for people, the folder of the weights.
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
        """As :meth:`model.prediction.protocol.Predictor.predict`. The likeliest choices are
        taken."""
        start = time.perf_counter()
        progress(0.0, "Reading shapes")
        example = make_example(segmented, self._reader.encoder.config.points, seed=seed)
        prompt = self._reader.prompt_embeddings(example)
        text, likely, told = self._answer(
            prompt,
            segmented,
            locked,
            seed,
            lambda fraction, message: progress(0.1 + 0.9 * fraction, message),
        )
        tree, problems = parse_answer(text)
        told += problems
        if tree is not None:
            tree = _fitted(tree, segmented, locked, told)
        confidence = {} if tree is None else {j.child: likely(j.child) for j in tree.joints}
        confidence |= {j.child: 1.0 for j in locked if j.child in confidence}
        return Prediction(
            tree, tuple(told), confidence, self.name, seed, time.perf_counter() - start, text
        )

    def _answer(
        self,
        prompt: Tensor,
        segmented: SegmentedObject,
        locked: tuple[Joint, ...],
        seed: int,
        progress: Progress,
    ) -> tuple[str, Callable[[str], float], list[str]]:
        """The text, the probability of what it says of a link, and what went wrong."""
        if isinstance(self._engine, LocalEngine):
            written = self._engine.write(prompt, Author(segmented, locked), progress=progress)
            odds = written.log_probabilities
            return written.text, lambda link: math.exp(min(odds.get(link, 0.0), 0.0)), []
        most = TOKENS_AT_LEAST + TOKENS_PER_PART * len(segmented.parts)
        answer = self._engine.generate(prompt, max_tokens=most, seed=seed, progress=progress)
        told = [] if answer.complete else ["the answer was cut off at its longest length"]
        likely = math.exp(min(answer.log_probability, 0.0))
        return answer.text, lambda link: likely, told


def _fitted(
    tree: KinematicTree, segmented: SegmentedObject, locked: tuple[Joint, ...], told: list[str]
) -> KinematicTree | None:
    """The tree with locked joints as they were, where it fits the parts."""
    try:
        for joint in locked:
            tree = tree.with_joint(joint)
        return ArticulatedObject(segmented.name, segmented.parts, tree).tree
    except KinematicsError as error:
        told += error.problems
        return None


def load_full_predictor(folder: Path, *, engine: str = "local") -> FullPredictor:
    """A predictor from a folder that :meth:`FullModel.save` wrote; on the GPU where there is one.

    Args:
        folder: of the weights.
        engine: "local" or "vllm".

    Raises:
        InputFileError: where the weights are absent or don't fit.
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
    """The paper-size model with our own decoder."""
    return load_full_predictor(Path(folder))


@lru_cache(maxsize=1)
def with_vllm(folder: str) -> FullPredictor:
    """The paper-size model with vLLM."""
    return load_full_predictor(Path(folder), engine="vllm")
