"""Constrained writing: a language model makes the choices of an :class:`AnswerScript`.

Forced text is read in one pass. Tokens are those of the whole text: the last token before a choice
is held back, as the choice may extend it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from tokenizers import Tokenizer
from torch import Tensor

from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.language_model import Decoder
from model.prediction.arti4urdf.text_script import AnswerScript, Numbers, OneOf


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
