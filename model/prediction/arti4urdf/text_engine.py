"""Engines that continue a prompt of embeddings: our decoder, and vLLM."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Protocol

import torch
from tokenizers import Tokenizer
from torch import Tensor

from model.core.packages import require
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.language_model import Decoder
from model.prediction.arti4urdf.text_script import AnswerScript
from model.prediction.arti4urdf.text_writing import TokenTexts, Written, write


@dataclass(frozen=True)
class Generated:
    """A continuation.

    Attributes:
        text: with special tokens, without the end.
        log_probability: mean over its tokens.
        complete: it ended before the limit.
    """

    text: str
    log_probability: float
    complete: bool


class TextEngine(Protocol):
    """Continues a prompt."""

    def generate(
        self, prompt: Tensor, *, max_tokens: int, progress: Progress = no_progress
    ) -> Generated:
        """Continue ``prompt`` (T, D) with the likeliest token each time."""
        ...


class LocalEngine:
    """Our decoder with its cache, on the device of its weights.

    Args:
        decoder: of a Qwen3 folder. tokenizer: of the same folder.
        end: id of the token that ends an answer.
    """

    def __init__(self, decoder: Decoder, tokenizer: Tokenizer, end: int) -> None:
        self._decoder, self._tokenizer, self._end = decoder, tokenizer, end

    @torch.inference_mode()
    def generate(
        self, prompt: Tensor, *, max_tokens: int, progress: Progress = no_progress
    ) -> Generated:
        """As :meth:`TextEngine.generate`."""
        decoder = self._decoder
        weight = decoder.model.norm.weight
        cache = decoder.new_cache(1, capacity=len(prompt) + max_tokens)
        hidden = decoder(prompt[None].to(weight.device, weight.dtype), cache=cache)
        tokens: list[int] = []
        total = 0.0
        complete = False
        while len(tokens) < max_tokens and not complete:
            odds = decoder.logits(hidden[0, -1]).float().log_softmax(-1)
            token = int(odds.argmax())
            total += float(odds[token])
            complete = token == self._end
            tokens.append(token)
            progress(len(tokens) / max_tokens, f"Writing, {len(tokens)} tokens")
            step = torch.tensor([[token]], device=weight.device)
            if not complete and len(tokens) < max_tokens:
                hidden = decoder(decoder.embed(step), cache=cache)
        words = tokens[:-1] if complete else tokens
        text = self._tokenizer.decode(words, skip_special_tokens=False)
        return Generated(text, total / max(len(tokens), 1), complete)

    @torch.inference_mode()
    def write(
        self, prompt: Tensor, script: AnswerScript, *, progress: Progress = no_progress
    ) -> Written:
        """As :func:`model.prediction.arti4urdf.text_writing.write`."""
        return write(self._decoder, self._tokenizer, self._texts, prompt, script, progress=progress)

    @cached_property
    def _texts(self) -> TokenTexts:
        return TokenTexts(self._tokenizer)


class VllmEngine:
    """vLLM with prompt embeddings, for GPUs and many requests.

    Written against vLLM's documentation, but not tested: vLLM needs a GPU.

    Args:
        folder: a Qwen3 folder, such as ``language_model`` of a saved model.
        end: id of the token that ends an answer.
    """

    def __init__(self, folder: Path, end: int) -> None:
        vllm = require("vllm", "vllm", "the engine vllm")
        self._sampling, self._end = vllm.SamplingParams, end
        self._model = vllm.LLM(model=str(folder), enable_prompt_embeds=True, dtype="bfloat16")

    def generate(
        self, prompt: Tensor, *, max_tokens: int, progress: Progress = no_progress
    ) -> Generated:
        """As :meth:`TextEngine.generate`, with progress at the beginning and the end only."""
        progress(0.0, "Writing")
        options = self._sampling(
            temperature=0.0,
            max_tokens=max_tokens,
            stop_token_ids=[self._end],
            skip_special_tokens=False,
            logprobs=0,
        )
        embeds = prompt.to("cpu", torch.bfloat16)
        (request,) = self._model.generate([{"prompt_embeds": embeds}], options, use_tqdm=False)
        answer = request.outputs[0]
        progress(1.0, "Writing")
        likely = (answer.cumulative_logprob or 0.0) / max(len(answer.token_ids), 1)
        complete = answer.finish_reason == "stop"
        return Generated(answer.text, likely if math.isfinite(likely) else -math.inf, complete)
