"""Constrained writing: a language model makes the choices, and the rest of the text is forced.

The choices are those of an :class:`AnswerScript`, written by our decoder or vLLM, which continue a
prompt of embeddings, or the values of JSON of a fixed form. Forced text is read in one pass. Tokens
are those of the whole text: the last token before a choice is held back, as the choice may extend
it. JSON is valid whatever the weights, and each choice has a probability; the tokens that end a
string (``"``, ``",``) count together.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cached_property, lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import torch
from torch import Tensor

from model.core.errors import InputFileError
from model.core.packages import require
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.checkpoints import load_qwen3
from model.prediction.arti4urdf.language_model import Decoder
from model.prediction.arti4urdf.text_script import AnswerScript, Numbers, OneOf

if TYPE_CHECKING:
    from tokenizers import Tokenizer


@dataclass(frozen=True)
class Written:
    """A written answer.

    Attributes:
        text: of the answer.
        log_probabilities: link → sum over the choices about it; "" for the base.
        choices, passes: number of choices, and of forward passes of the decoder.
    """

    text: str
    log_probabilities: dict[str, float]
    choices: int
    passes: int


def write(
    decoder: Decoder,
    tokenizer: Tokenizer,
    texts: TokenTexts,
    prompt: Tensor,
    script: AnswerScript,
    *,
    progress: Progress = no_progress,
) -> Written:
    """Write an answer with the likeliest text or number at each choice.

    Args:
        decoder, tokenizer: of the language model. texts: of the tokenizer's tokens.
        prompt: (T, D) embeddings. script: of the answer. progress: reports each choice.
    """
    writer = _Writer(decoder, tokenizer, texts, prompt)
    steps = script.steps()
    odds: dict[str, float] = {}
    most = 3.0 + 12.0 * len(script.links)
    try:
        step = next(steps)
        while True:
            answer = ""
            if isinstance(step, str):
                writer.force(step)
            else:
                choose = writer.one_of if isinstance(step, OneOf) else writer.numbers
                answer, likely = choose(step)  # type: ignore[arg-type]
                odds[step.about] = odds.get(step.about, 0.0) + likely
                progress(min(writer.choices / most, 0.99), f"Writing, {writer.choices} choices")
            step = steps.send(answer)
    except StopIteration:
        return Written(writer.text, odds, writer.choices, writer.passes)


class _Writer:
    """The text so far, and the part of it that the decoder has read."""

    def __init__(
        self, decoder: Decoder, tokenizer: Tokenizer, texts: TokenTexts, prompt: Tensor
    ) -> None:
        self._decoder, self._tokenizer, self._texts = decoder, tokenizer, texts
        self._device = decoder.model.norm.weight.device
        self._dtype = decoder.model.norm.weight.dtype
        self._cache = decoder.new_cache(1, capacity=len(prompt) + 2048)
        self.passes = 0
        self._odds = self._read(prompt[None].to(self._device, self._dtype))
        self._held = ""
        self.text = ""
        self.choices = 0

    def force(self, text: str) -> None:
        """Append a text; the decoder reads it before the next choice."""
        self.text += text
        self._held += text

    def one_of(self, ask: OneOf) -> tuple[str, float]:
        """The likeliest text, and the logarithm of its probability."""
        self.choices += 1
        rows = [self._ids(self._held + text) for text in ask.texts]
        alive, total, at = list(range(len(rows))), 0.0, 0
        while len(alive) > 1:
            shared = at
            while len({rows[k][shared] if shared < len(rows[k]) else -1 for k in alive}) == 1:
                shared += 1
            self._commit(rows[alive[0]][at:shared])
            at = shared
            following = sorted({rows[k][at] for k in alive if at < len(rows[k])})
            if not following:
                break  # equal tokens
            odds = self._odds[following].log_softmax(-1)
            best = int(odds.argmax())
            total += float(odds[best])
            alive = [k for k in alive if at < len(rows[k]) and rows[k][at] == following[best]]
        chosen = alive[0]
        self.text += ask.texts[chosen]
        self._keep(rows[chosen], at)
        return ask.texts[chosen], total

    def numbers(self, ask: Numbers) -> tuple[str, float]:
        """The likeliest numbers token by token, and the logarithm of their probability."""
        self.choices += 1
        ids = self._ids(self._held)
        self._commit(ids[:-1])
        before = self._tokenizer.decode(ids[-1:], skip_special_tokens=False)
        text, total = "", 0.0
        while True:
            able, ends = self._texts.continuing(before, text, ask)
            odds = self._odds[able + ends].log_softmax(-1)
            end = float(odds[len(able) :].logsumexp(-1)) if ends else -math.inf
            best = int(odds[: len(able)].argmax()) if able else -1
            if best < 0 or end >= float(odds[best]):
                total += end
                break
            total += float(odds[best])
            self._commit([able[best]])
            text += self._texts.texts[able[best]][len(before) :]
            before = ""
        self.text += text
        self._held = ""
        return text, total

    def _keep(self, ids: list[int], done: int) -> None:
        """Read all but the last token, which may still be extended."""
        self._commit(ids[done:-1])
        rest = ids[max(done, len(ids) - 1) :]
        self._held = self._tokenizer.decode(rest, skip_special_tokens=False)

    def _ids(self, text: str) -> list[int]:
        return self._tokenizer.encode(text, add_special_tokens=False).ids

    def _commit(self, ids: list[int]) -> None:
        if ids:
            tokens = torch.tensor([ids], device=self._device)
            self._odds = self._read(self._decoder.embed(tokens))

    def _read(self, embeds: Tensor) -> Tensor:
        self.passes += 1
        hidden = self._decoder(embeds, cache=self._cache)
        return self._decoder.logits(hidden[0, -1]).float().cpu()


class TokenTexts:
    """The tokens' texts, and those that can continue a number."""

    def __init__(self, tokenizer: Tokenizer) -> None:
        count = tokenizer.get_vocab_size()
        self.texts = tokenizer.decode_batch([[i] for i in range(count)], skip_special_tokens=False)
        digits = set("0123456789.- ")
        self._numeric = [i for i, t in enumerate(self.texts) if t and set(t) <= digits]
        self._beginning: dict[str, list[int]] = {}
        self._quotes = [i for i, t in enumerate(self.texts) if t.startswith('"')]

    def continuing(self, before: str, text: str, ask: Numbers) -> tuple[list[int], list[int]]:
        """Tokens that continue a number, and tokens that end it.

        Args:
            before: text of a token that is held back, which the next token must begin with.
            text: of the number so far.
        """
        if before:
            if before not in self._beginning:
                found = [i for i, t in enumerate(self.texts) if t.startswith(before)]
                self._beginning[before] = found
            found = self._beginning[before]
            return [i for i in found if ask.allows(self.texts[i][len(before) :])], []
        able = [i for i in self._numeric if ask.allows(text + self.texts[i])]
        return able, self._quotes if ask.allows(text, complete=True) else []


LONGEST_SENTENCE, LONGEST_NAME, MOST_NAMES = 60, 8, 8
"""Most tokens of the reason and of a name, and most names in a list."""


class JsonWriter:
    """Answers a system prompt and a user prompt with one decision about one object.

    Args:
        decoder: in evaluation mode. tokenizer: of the same folder.
    """

    def __init__(self, decoder: Decoder, tokenizer: Any) -> None:
        self._decoder, self._tokenizer = decoder, tokenizer
        self._device = decoder.model.norm.weight.device
        count = min(tokenizer.get_vocab_size(), decoder.config.vocab_size)
        # Special tokens decode to "".
        self._texts: list[str] = tokenizer.decode_batch(
            [[i] for i in range(count)], skip_special_tokens=True
        )
        self._plain = self._mask(
            [
                bool(t) and t.isprintable() and not set(t) & {'"', "\\", "\ufffd"}
                for t in self._texts
            ]
        )
        self._closing = self._mask([t.startswith('"') for t in self._texts])
        self._fits = lru_cache(maxsize=64)(self._compatible)
        self._start = ""
        self._cache = decoder.new_cache()
        self._next = torch.zeros(count)

    @torch.inference_mode()
    def decide(self, system: str, user: str) -> str:
        """``{"reason", "articulable", "parts", "kind", "base", "confidence"}``; the confidence is
        the probability of ``articulable``."""
        self._read(
            f"<|im_start|>system\n{system}<|im_end|>\n",
            f"<|im_start|>user\n{user}<|im_end|>\n<|im_start|>assistant\n<think>\n\n</think>\n\n",
        )
        out: dict[str, Any] = {"id": 0}
        self._feed('{"objects": [{"id": 0, "reason": "')
        out["reason"] = self._string(LONGEST_SENTENCE)
        self._feed(', "articulable": ')
        word, confidence = self.choose(("true", "false"))
        out["articulable"], out["confidence"] = word == "true", confidence
        self._feed(', "parts": [')
        out["parts"] = self._names() if out["articulable"] else []
        self._feed('], "kind": "')
        out["kind"] = self._string(LONGEST_NAME)
        self._feed(', "base": "')
        out["base"] = self.choose(("fixed", "free"), feed=False)[0]
        return json.dumps(out, ensure_ascii=False)

    def _names(self) -> list[str]:
        self._feed('"')
        names = [self._string(LONGEST_NAME)]
        while len(names) < MOST_NAMES and self.choose((",", "]"), feed=False)[0] == ",":
            self._feed(', "')
            names.append(self._string(LONGEST_NAME))
        return list(dict.fromkeys(n for n in names if n))

    def _read(self, start: str, rest: str) -> None:
        """Start a new prompt; its common beginning is read once."""
        if start != self._start:
            self._cache, self._start = self._decoder.new_cache(), start
            self._feed(start)
            self._kept = self._cache.length
        self._cache.truncate(self._kept)
        self._feed(rest)

    def _feed(self, text: str) -> None:
        self._append(self._tokenizer.encode(text, add_special_tokens=False).ids)

    def _append(self, ids: list[int]) -> None:
        tokens = torch.tensor([ids], device=self._device)
        hidden = self._decoder(self._decoder.embed(tokens), cache=self._cache)
        logits = self._decoder.logits(hidden[0, -1]).float().cpu()[: len(self._texts)]
        self._next = torch.nan_to_num(logits).softmax(-1)

    def _string(self, longest: int) -> str:
        """The rest of a nonempty string after its opening quote, which is closed."""
        ids: list[int] = []
        while len(ids) < longest:
            best = int((self._next * self._plain).argmax())
            if ids and float((self._next * self._closing).sum()) >= float(self._next[best]):
                break
            ids.append(best)
            self._append([best])
        self._feed('"')
        text = self._tokenizer.decode(ids)
        return " ".join("".join(c if c.isprintable() else " " for c in text).split())

    def choose(self, options: tuple[str, str], feed: bool = True) -> tuple[str, float]:
        """The likelier of two next texts and its probability; with ``feed`` it is read, too."""
        first, second = (float((self._next * self._fits(o)).sum()) for o in options)
        chosen, mass = (options[0], first) if first >= second else (options[1], second)
        if feed:
            self._feed(chosen)
        return chosen, mass / (first + second) if first + second > 0 else 0.5

    def _compatible(self, option: str) -> Tensor:
        """Tokens that agree with the beginning of an option, after an optional space."""
        bare = [t.lstrip(" ") for t in self._texts]
        return self._mask(
            [bool(t) and (t.startswith(option) or option.startswith(t)) for t in bare]
        )

    @staticmethod
    def _mask(values: list[bool]) -> Tensor:
        return torch.tensor(values, dtype=torch.float32)


@lru_cache(maxsize=1)
def load_json_writer(folder: Path) -> JsonWriter:
    """A writer with the weights of a Qwen3 folder, on the GPU if there is one.

    Raises:
        InputFileError: if the folder isn't one.
    """
    device = torch.device("cuda" if torch.cuda.is_available() else "cpu")
    loaded = load_qwen3(folder, dtype=torch.bfloat16 if device.type == "cuda" else torch.float32)
    if loaded.tokenizer.get_vocab_size() > loaded.decoder.config.vocab_size:
        raise InputFileError(folder, "its tokenizer knows more tokens than the model has rows for")
    return JsonWriter(loaded.decoder.to(device), loaded.tokenizer)


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
