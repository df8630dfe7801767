"""JSON of a fixed form from Qwen3: the frame is forced, the model chooses the values.

The result is valid JSON whatever the weights, and each choice has a probability. The tokens that
end a string (``"``, ``",``) count together.
"""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from model.core.errors import InputFileError
from model.prediction.arti4urdf.language_model import Decoder
from model.prediction.arti4urdf.published_weights import load_qwen3

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
        self._plain = self._mask([
            bool(t) and t.isprintable() and not set(t) & {'"', "\\", "\ufffd"} for t in self._texts
        ])  # fmt: skip
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
