"""The paper-size Arti4URDF: ULIP-2's Point-BERT, two adapters and Qwen3 by transformers.

Source: ArtiWorld (CVPR 2026), Arti4URDF: the features of the object and of its parts replace the
placeholder words ``<g>`` and ``<p>`` of the prompt in their order, and the language model is
trained on the answer's tokens.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from copy import deepcopy
from dataclasses import asdict, dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from model.core.errors import ConfigurationError, InputFileError
from model.core.files import strict_load
from model.core.packages import require
from model.prediction.arti4urdf.checkpoints import (
    TOKENIZER_FILE,
    from_config,
    load_checkpoint,
    load_point_bert,
    load_tokenizer,
    read_qwen3_config,
    save_checkpoint,
)
from model.prediction.arti4urdf.point_bert import (
    Groups,
    PointBert,
    PointBertConfig,
    Projector,
    group_points,
)

if TYPE_CHECKING:
    from tokenizers import Tokenizer

GLOBAL, PART = "<g>", "<p>"
_BOUNDS = [f"<{what}_{end}>" for what in ("g", "p", "json", "urdf") for end in ("start", "end")]
SPECIAL_TOKENS = (*_BOUNDS, GLOBAL, PART)
END_OF_TURN = "<|im_end|>"
IGNORED = -100
_ATTENTION_AND_MLP = [f"{name}_proj" for name in ("q", "k", "v", "o", "gate", "up", "down")]
LANGUAGE, GEOMETRY = "language_model", "geometry"
"""Folders of a saved model."""


@dataclass(frozen=True)
class LoraSettings:
    """Low-rank adapters instead of training every weight of the language model.

    Attributes:
        rank: of the update.
        alpha: its scale is ``alpha / rank``.
        dropout: before the update, in training.
    """

    rank: int = 16
    alpha: int = 32
    dropout: float = 0.05


@dataclass(frozen=True, eq=False)
class Example:
    """The model's input for one object.

    Attributes:
        prompt: with one ``<g>`` and a ``<p>`` for each part.
        cloud: (N, 6) of the whole object, normalised (:func:`text_prompt.normalised`).
        parts: (P, N, 6) of each part, each normalised, in the prompt's order.
        answer: target text; "" in use.
    """

    prompt: str
    cloud: Tensor
    parts: Tensor
    answer: str = ""


class FullModel(nn.Module):
    """Clouds and words in, words out.

    Args:
        encoder: Point-BERT; it is frozen.
        language_model: a causal language model of transformers, or peft's wrapper of one.
        tokenizer: knows :data:`SPECIAL_TOKENS`.
    """

    def __init__(self, encoder: PointBert, language_model: Any, tokenizer: Tokenizer) -> None:
        super().__init__()
        self.tokenizer = tokenizer
        self.encoder = encoder
        self.language_model = language_model
        width = language_model.config.hidden_size
        self.global_adapter = Projector(encoder.config.output_width, width)
        self.part_adapter = Projector(encoder.config.output_width, width)
        encoder.requires_grad_(False)
        self._slots = {name: self._id(name) for name in (GLOBAL, PART)}
        self.end = self._id(END_OF_TURN)

    def _id(self, token: str) -> int:
        found = self.tokenizer.token_to_id(token)
        if found is None:
            raise ConfigurationError(f"the tokenizer doesn't know {token}; add it first")
        return found

    @property
    def device(self) -> torch.device:
        """Device that the model computes on."""
        return self.global_adapter.fc1.weight.device

    def train(self, mode: bool = True) -> FullModel:
        """Set the mode of all but the encoder, which stays in evaluation mode."""
        super().train(mode)
        self.encoder.eval()
        return self

    def geometry(self, clouds: Tensor) -> Tensor:
        """(B, N, 6) clouds → (B, output_width) features in the adapters' type."""
        clouds = clouds.to(self.device, torch.float32)
        # The same precision in training as in use.
        with torch.autocast(self.device.type, enabled=False), torch.no_grad():
            groups = group_points(clouds, self.encoder.config)
            weight = self.encoder.norm.weight
            features = self.encoder(Groups(*(part.to(weight.dtype) for part in groups)))
        return features.to(self.global_adapter.fc1.weight.dtype)

    def embed(self, examples: Sequence[Example]) -> tuple[Tensor, Tensor, Tensor]:
        """Prompts and answers as embeddings, padded at the right.

        Returns:
            (B, T, D) embeddings, (B, T) int64 mask, (B, T) labels: the answers' tokens, else
            :data:`IGNORED`.

        Raises:
            ConfigurationError: if a prompt's placeholders don't agree with its clouds.
        """
        rows = [self._tokens(example) for example in examples]
        longest = max(len(ids) for ids, _ in rows)
        ids = torch.full((len(rows), longest), self.end)
        mask, labels = torch.zeros_like(ids), torch.full_like(ids, IGNORED)
        for row, (tokens, prompt) in enumerate(rows):
            ids[row, : len(tokens)] = torch.tensor(tokens)
            mask[row, : len(tokens)] = 1
            labels[row, prompt : len(tokens)] = ids[row, prompt : len(tokens)]
        ids, mask, labels = (t.to(self.device) for t in (ids, mask, labels))
        embeds = self.language_model.get_input_embeddings()(ids)
        wholes = torch.stack([e.cloud for e in examples])
        parts = torch.cat([e.parts for e in examples])
        # Farthest-point sampling is sequential: all clouds together take as long as one.
        features = self.geometry(torch.cat([wholes, parts])).split([len(wholes), len(parts)])
        for slot, adapter, feature in (
            (GLOBAL, self.global_adapter, features[0]),
            (PART, self.part_adapter, features[1]),
        ):
            tokens = adapter(feature).to(embeds.dtype)
            where = ((ids == self._slots[slot]) & (mask == 1))[..., None]
            # masked_scatter goes row by row, as the clouds were concatenated.
            embeds = embeds.masked_scatter(where, tokens)
        return embeds, mask, labels

    def _tokens(self, example: Example) -> tuple[list[int], int]:
        """Ids of prompt and answer, and how many belong to the prompt."""
        prompt = self.tokenizer.encode(example.prompt, add_special_tokens=False).ids
        for slot, clouds in ((GLOBAL, 1), (PART, len(example.parts))):
            found = prompt.count(self._slots[slot])
            if found != clouds:
                raise ConfigurationError(f"the prompt has {found} {slot} for {clouds} clouds")
        if not example.answer:
            return prompt, len(prompt)
        answer = self.tokenizer.encode(example.answer, add_special_tokens=False).ids
        if set(answer) & set(self._slots.values()):
            raise ConfigurationError(f"an answer must not hold {GLOBAL} or {PART}")
        return [*prompt, *answer, self.end], len(prompt)

    def forward(self, examples: Sequence[Example]) -> Tensor:
        """Mean cross-entropy of the answers' tokens (the paper's loss)."""
        embeds, mask, labels = self.embed(examples)
        # No word of the prompt is predicted, and a row of logits has 151,936 numbers.
        first = int((labels != IGNORED).any(0).nonzero()[0])
        answer = self.language_model(
            inputs_embeds=embeds,
            attention_mask=mask,
            use_cache=False,
            logits_to_keep=labels.shape[1] - first + 1,
        )
        logits = answer.logits[:, :-1].float()
        return functional.cross_entropy(
            logits.flatten(0, 1), labels[:, first:].flatten(), ignore_index=IGNORED
        )

    @torch.no_grad()
    def prompt_embeddings(self, example: Example) -> Tensor:
        """(T, D) embeddings of a prompt, for an engine that generates."""
        embeds, _, _ = self.embed([Example(example.prompt, example.cloud, example.parts)])
        return embeds[0]

    def use_gradient_checkpointing(self) -> None:
        """Trade time for memory in training."""
        self.language_model.gradient_checkpointing_enable({"use_reentrant": False})

    def trained_parameters(self) -> Iterator[nn.Parameter]:
        """The parameters for an optimiser."""
        return (parameter for parameter in self.parameters() if parameter.requires_grad)

    def save(self, folder: Path) -> None:
        """Write a folder that :func:`load_full_model` reads; LoRA is merged into a copy first.

        ``language_model`` inside is a Qwen3 folder that any other program can load.
        """
        language, head = folder / LANGUAGE, self.language_model
        if hasattr(head, "merge_and_unload"):
            head = deepcopy(head).merge_and_unload()
        head.save_pretrained(language)
        self.tokenizer.save(str(language / TOKENIZER_FILE))
        state = {
            f"{name}.{key}": value
            for name in ("encoder", "global_adapter", "part_adapter")
            for key, value in getattr(self, name).state_dict().items()
        }
        # Written last: it marks the folder as complete.
        config = {"kind": "full", "point_bert": asdict(self.encoder.config)}
        save_checkpoint(folder / GEOMETRY, config, state, dtype=torch.float32)


def make_full_model(
    ulip2: Path,
    qwen3: Path,
    *,
    dtype: torch.dtype = torch.bfloat16,
    lora: LoraSettings | None = None,
) -> FullModel:
    """A model to be trained, from published weights on disk; nothing is downloaded.

    Raises:
        InputFileError: if weights are absent or don't fit.
        ConfigurationError: if LoRA is asked for and peft isn't installed.
    """
    from tokenizers import AddedToken

    read_qwen3_config(qwen3)
    encoder = load_point_bert(ulip2)
    tokenizer = load_tokenizer(qwen3)
    language_model = _load_language_model(qwen3, dtype)
    known = min(tokenizer.get_vocab_size(), language_model.config.vocab_size)
    tokenizer.add_special_tokens([AddedToken(t, special=True) for t in SPECIAL_TOKENS])
    _grow_vocabulary(language_model, known, tokenizer.get_vocab_size())
    if lora is not None:
        language_model = _with_lora(language_model, lora, tokenizer)
    model = FullModel(encoder, language_model, tokenizer)
    model.global_adapter.to(dtype)
    model.part_adapter.to(dtype)
    return model


class _Words(nn.Module):
    """The embedding table alone, for engines that hold the language model."""

    def __init__(self, table: nn.Embedding) -> None:
        super().__init__()
        self.table = table
        self.config = SimpleNamespace(hidden_size=table.embedding_dim)

    def get_input_embeddings(self) -> nn.Embedding:
        return self.table


def load_full_model(
    folder: Path, *, dtype: torch.dtype = torch.bfloat16, words: nn.Embedding | None = None
) -> FullModel:
    """Read what :meth:`FullModel.save` wrote, in evaluation mode.

    Args:
        folder: of the model.
        dtype: of all but the encoder.
        words: the embedding table; the language model is then not loaded.

    Raises:
        InputFileError: if something is absent, damaged or doesn't fit.
    """
    geometry = load_checkpoint(folder / GEOMETRY)
    if geometry.config.get("kind") != "full":
        raise InputFileError(geometry.folder, "is no checkpoint of the full model")
    bert = from_config(PointBertConfig, geometry.config.get("point_bert"), geometry.folder)
    language = folder / LANGUAGE
    language_model = _load_language_model(language, dtype) if words is None else _Words(words)
    model = FullModel(PointBert(bert), language_model, load_tokenizer(language))
    pieces = nn.ModuleDict(
        {name: getattr(model, name) for name in ("encoder", "global_adapter", "part_adapter")}
    )
    strict_load(pieces, geometry.state, geometry.folder)
    model.global_adapter.to(dtype)
    model.part_adapter.to(dtype)
    return model.eval()


def _load_language_model(folder: Path, dtype: torch.dtype) -> Any:
    """Qwen3 by transformers, but a missing weight is an error."""
    from transformers import Qwen3ForCausalLM

    read_qwen3_config(folder)
    try:
        loaded: Any = Qwen3ForCausalLM.from_pretrained(
            folder, local_files_only=True, dtype=dtype, output_loading_info=True
        )
    except (OSError, ValueError, RuntimeError, TypeError, KeyError) as error:
        first = str(error).strip().splitlines()[:1] or [type(error).__name__]
        raise InputFileError(folder, f"can't be loaded ({first[0][:200]})") from error
    model, report = loaded
    for kind in ("missing_keys", "unexpected_keys", "mismatched_keys", "error_msgs"):
        found = sorted(str(key) for key in report.get(kind) or ())
        if found:
            raise InputFileError(folder, f"{kind.replace('_', ' ')}: {', '.join(found[:4])}")
    return model


def _grow_vocabulary(language_model: Any, known: int, size: int) -> None:
    """Rows for ``size`` tokens at least; those from ``known`` on become the mean embedding."""
    if size > language_model.config.vocab_size:
        language_model.resize_token_embeddings(size, mean_resizing=False)
    tables = {
        id(t.weight): t.weight
        for t in (language_model.get_input_embeddings(), language_model.get_output_embeddings())
    }
    with torch.no_grad():
        for table in tables.values():
            table[known:] = table[:known].float().mean(0).to(table.dtype)


def _with_lora(language_model: Any, settings: LoraSettings, tokenizer: Tokenizer) -> Any:
    peft = require("peft", "artiworld[train]", "LoRA")
    new_words = [i for t in SPECIAL_TOKENS if (i := tokenizer.token_to_id(t)) is not None]
    config = peft.LoraConfig(
        r=settings.rank,
        lora_alpha=settings.alpha,
        lora_dropout=settings.dropout,
        target_modules=_ATTENTION_AND_MLP,
        # The embeddings of new words are untrained, so they are trained in full.
        trainable_token_indices=new_words,
        task_type="CAUSAL_LM",
    )
    return peft.get_peft_model(language_model, config)
