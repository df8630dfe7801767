"""The small Arti4URDF: Point-BERT, two adapters, a Qwen3 decoder, pointers to parts, its weights.

The order of the input is the paper's (Arti4URDF, input format): the global token between
``<g_start>`` and ``<g_end>``, the parts between ``<p_start>`` and ``<p_end>``, each as a shape
token and a structure token, then the answer. A checkpoint folder holds weights, configuration,
vocabulary and record.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from model.core.errors import InputFileError
from model.core.files import static_assets, strict_load
from model.prediction.arti4urdf import vocabulary
from model.prediction.arti4urdf import vocabulary as v
from model.prediction.arti4urdf.checkpoints import from_config, load_checkpoint, save_checkpoint
from model.prediction.arti4urdf.language_model import Decoder, DecoderConfig, KeyValueCache
from model.prediction.arti4urdf.point_bert import (
    NANO,
    PointBert,
    PointBertConfig,
    Projector,
    group_points,
)
from model.prediction.arti4urdf.structure import (
    AREA_ROOT,
    CANDIDATE_SCALARS,
    CANDIDATE_VECTORS,
    RELATIONS,
    SCALARS,
    SLOTS,
    VECTORS,
    StructureArrays,
)
from model.prediction.arti4urdf.vocabulary import Token

CODE = 32
"""Width of the code that identifies a part; it stands for the file name link_i."""
FREQUENCIES = 5
MOST_BIAS = 8.0
"""Largest contribution of the relation of two parts to a pointer's logit."""


@dataclass(frozen=True)
class ModelConfig:
    """Sizes of the small model.

    Attributes:
        point_bert: encoder of clouds. decoder: the language model.
        structure_width: inner width of the structure prompt's MLP.
        global_token, structure_prompt, json_step: switched off in ablations.
    """

    point_bert: PointBertConfig = NANO
    decoder: DecoderConfig = field(
        default_factory=lambda: DecoderConfig(v.SIZE, 160, 416, 5, 5, 1, head_dim=32)
    )
    structure_width: int = 384
    global_token: bool = True
    structure_prompt: bool = True
    json_step: bool = True


@dataclass(frozen=True, eq=False)
class Prompt:
    """The network's input for one object.

    Attributes:
        arrays: geometry. category: word id, names: word ids a part (may be empty).
        codes: (P,) number of each part's code.
        whole: (N, 3) cloud of the whole object; None draws it from the parts.
    """

    arrays: StructureArrays
    category: int
    names: tuple[tuple[int, ...], ...]
    codes: np.ndarray
    whole: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Encoded:
    """Prompts after the encoders, padded to P parts.

    Attributes:
        prefix: (B, T, D) embeddings up to ``<p_end>``; valid: (B, T).
        parts: (B, P, D) input of a token that points at a part. keys: (B, P, K) of the pointers.
        bias: (B, P, P, 2) contribution to the logit that the column is the row's child; second
            channel, on the diagonal: that it is the root.
        shapes: (sum P, D) adapted shape features of all parts, for the auxiliary type head.
    """

    prefix: Tensor
    valid: Tensor
    parts: Tensor
    keys: Tensor
    bias: Tensor
    shapes: Tensor


def part_codes() -> Tensor:
    """(256, CODE) fixed codes of unit length, nearly orthogonal."""
    rng = np.random.default_rng(20260101)
    codes = rng.standard_normal((256, CODE))
    codes /= np.linalg.norm(codes, axis=1, keepdims=True)
    return torch.from_numpy(codes.astype(np.float32)) * 2


def whitened_cloud(points: Tensor) -> Tensor:
    """(B, N, 3) → (B, N, 6): centred and scaled by the largest radius (the paper's φ_norm).

    The colour channels carry the same points with each axis scaled to unit variance.
    """
    centred = points - points.mean(1, keepdim=True)
    radius = centred.square().sum(-1).amax(1).sqrt().clamp_min(1e-6)
    spread = centred.std(1, keepdim=True).clamp_min(1e-4)
    return torch.cat([centred / radius[:, None, None], 0.4 * centred / spread], -1)


def _fourier(values: Tensor) -> Tensor:
    angles = values[..., None] * (2.0 ** torch.arange(FREQUENCIES, device=values.device)) * 2
    return torch.cat([values, angles.sin().flatten(-2), angles.cos().flatten(-2)], -1)


class ArtiModel(nn.Module):
    """Parts in, log-probabilities of the answer's tokens out."""

    def __init__(self, config: ModelConfig | None = None) -> None:
        super().__init__()
        self.config = config or ModelConfig()
        width = self.config.decoder.hidden_size
        self.point_encoder = PointBert(self.config.point_bert)
        geometry = self.config.point_bert.output_width
        self.global_adapter = Projector(geometry, width, normalised=True)
        self.part_adapter = Projector(geometry, width, normalised=True)
        self.decoder = Decoder(self.config.decoder)
        box = 9 * (1 + 2 * FREQUENCIES)
        self.location = _mlp(box + CODE, width, width)
        candidates = SLOTS * (CANDIDATE_SCALARS + 3 * CANDIDATE_VECTORS)
        inside = SCALARS + 3 * VECTORS + candidates + 2 * CODE
        self.structure = _mlp(inside, self.config.structure_width, width, normalised=True)
        self.pointed = nn.Linear(2 * width, width)
        # Without a norm the logits of pointers grow without bound.
        self.key = nn.Sequential(nn.Linear(3 * width, 64), nn.RMSNorm(64, eps=1e-6))
        self.query = nn.Sequential(nn.Linear(width, 64), nn.RMSNorm(64, eps=1e-6))
        self.relation = _mlp(2 * RELATIONS, 64, 2)
        self.type_head = nn.Linear(width, len(v.TYPES))
        self.register_buffer("codes", part_codes(), persistent=False)

    @property
    def device(self) -> torch.device:
        """Device that holds the weights."""
        return self.type_head.weight.device

    def encode(self, prompts: Sequence[Prompt]) -> Encoded:
        """Run the encoders over a batch of objects."""
        counts = [len(p.arrays) for p in prompts]
        shape, whole = self._shapes(prompts)
        box = self._stacked(prompts, lambda p: p.arrays.box)
        codes = self._codes(np.concatenate([p.codes for p in prompts]))
        half = box[:, 3:]
        place = _fourier(torch.cat([box[:, :3], half, half.log() / 4], -1))
        part = shape + self.location(torch.cat([place, codes], -1))
        part = part + self._name_embeddings(prompts)
        structure = self.structure(self._structure_input(prompts, codes))
        pad = _Padder(counts, self.device)
        tokens = pad(torch.stack([part, structure], 1))
        words = [v.ID[w] for w in ("<bos>", "<g_start>", "<g_end>", "<p_start>", "<p_end>")]
        start = self.decoder.embed(torch.tensor(words, device=self.device))
        category = self.decoder.embed(
            torch.tensor([p.category for p in prompts], device=self.device)
        )
        rows, valid = [], []
        longest = 7 + 2 * max(counts)
        for b, count in enumerate(counts):
            row = [
                start[0:1],
                category[b : b + 1],
                start[1:2],
                whole[b : b + 1],
                start[2:3],
                start[3:4],
                tokens[b, :count].flatten(0, 1),
                start[4:5],
            ]
            row = torch.cat(row)
            rows.append(functional.pad(row, (0, 0, 0, longest + 1 - len(row))))
            valid.append(torch.arange(longest + 1, device=self.device) < 2 * count + 7)
        parts = self.pointed(torch.cat([part, structure], -1))
        keys_in = torch.cat([part, structure, shape], -1)
        bias = self._relation_bias(prompts, max(counts))
        return Encoded(
            torch.stack(rows),
            torch.stack(valid),
            pad(parts),
            pad(self.key(keys_in)),
            bias,
            shape,
        )

    def _shapes(self, prompts: Sequence[Prompt]) -> tuple[Tensor, Tensor]:
        """Adapted features of all parts (sum P, D) and of the objects (B, D)."""
        count = self.config.point_bert.points
        points = self._stacked(prompts, lambda p: p.arrays.points)
        clouds = whitened_cloud(points[:, :count])
        whole = torch.from_numpy(np.stack([_whole(p, count) for p in prompts]))
        wholes = whitened_cloud(whole.to(points.device))
        groups = group_points(torch.cat([clouds, wholes]), self.config.point_bert)
        features = self.point_encoder(groups)
        parts, whole = features[: len(clouds)], features[len(clouds) :]
        whole = self.global_adapter(whole)
        if not self.config.global_token:
            whole = torch.zeros_like(whole)
        return self.part_adapter(parts), whole

    def _stacked(self, prompts: Sequence[Prompt], get: Any) -> Tensor:
        rows = np.concatenate([get(p) for p in prompts]).astype(np.float32)
        return torch.from_numpy(rows).to(self.device)

    def _codes(self, numbers: np.ndarray) -> Tensor:
        codes = self.get_buffer("codes")
        index = torch.from_numpy(np.asarray(numbers, np.int64)).to(self.device)
        return codes[index.clamp_min(0) % len(codes)] * (index >= 0)[:, None]

    def _name_embeddings(self, prompts: Sequence[Prompt]) -> Tensor:
        width = self.config.decoder.hidden_size
        rows = [ids for p in prompts for ids in p.names]
        out = torch.zeros(len(rows), width, device=self.device)
        index = [(r, w) for r, ids in enumerate(rows) for w in ids]
        if index:
            at = torch.tensor(index, device=self.device)
            out = out.index_add(0, at[:, 0], self.decoder.embed(at[:, 1]))
        return out

    def _structure_input(self, prompts: Sequence[Prompt], codes: Tensor) -> Tensor:
        scalars = self._stacked(prompts, lambda p: p.arrays.scalars)
        vectors = self._stacked(prompts, lambda p: p.arrays.vectors).flatten(1)
        slots = self._stacked(prompts, lambda p: p.arrays.candidate_scalars).flatten(1)
        lines = self._stacked(prompts, lambda p: p.arrays.candidate_vectors).flatten(1) * 2
        parents = np.concatenate(
            [np.where(p.arrays.parents >= 0, p.codes[p.arrays.parents], -1) for p in prompts]
        )
        parent = self._codes(parents)
        out = torch.cat([scalars, vectors, slots, lines], -1)
        if not self.config.structure_prompt:
            out, parent = torch.zeros_like(out), torch.zeros_like(parent)
        return torch.cat([out, codes, parent], -1)

    def _relation_bias(self, prompts: Sequence[Prompt], most: int) -> Tensor:
        """(B, P, P, 2), see :class:`Encoded`."""
        out = []
        for p in prompts:
            relations = torch.from_numpy(np.ascontiguousarray(p.arrays.relations)).to(self.device)
            if not self.config.structure_prompt:
                relations = torch.zeros_like(relations)
            both = torch.cat([relations, relations.transpose(0, 1)], -1)
            bias = MOST_BIAS * torch.tanh(self.relation(both) / MOST_BIAS)
            short = most - len(bias)
            out.append(functional.pad(bias, (0, 0, 0, short, 0, short)))
        return torch.stack(out)

    def embed(self, encoded: Encoded, words: Tensor, parts: Tensor) -> Tensor:
        """(B, T) words and pointed parts (-1: none) → (B, T, D) embeddings to append."""
        out = self.decoder.embed(words)
        index = parts.clamp_min(0)[..., None].expand(-1, -1, encoded.parts.shape[-1])
        pointed = encoded.parts.gather(1, index)
        return out + pointed * (parts >= 0)[..., None]

    def forward(
        self,
        encoded: Encoded,
        words: Tensor,
        parts: Tensor,
        *,
        lengths: Sequence[int] | None = None,
        cache: KeyValueCache | None = None,
    ) -> Tensor:
        """Hidden states of appended tokens, (B, T, D).

        Args:
            encoded: the prompts. words, parts: (B, T), see :meth:`embed`.
            lengths: tokens of each row that count; all by default.
            cache: where it is empty the prefix is read first; for one object.
        """
        embeds = self.embed(encoded, words, parts)
        if cache is not None and cache.length:
            return self.decoder(embeds, cache=cache)
        before = encoded.valid.sum(1).tolist()
        lengths = lengths or [embeds.shape[1]] * len(embeds)
        rows = [
            torch.cat([encoded.prefix[b, :n], embeds[b, :m]])
            for b, (n, m) in enumerate(zip(before, lengths, strict=True))
        ]
        joined = nn.utils.rnn.pad_sequence(rows, batch_first=True)
        hidden = self.decoder(joined, cache=cache)
        answers = [
            hidden[b, n : n + m] for b, (n, m) in enumerate(zip(before, lengths, strict=True))
        ]
        return nn.utils.rnn.pad_sequence(answers, batch_first=True)

    def word_logits(self, hidden: Tensor) -> Tensor:
        """(…, D) → (…, SIZE)."""
        return self.decoder.logits(hidden)

    def point(self, encoded: Encoded, hidden: Tensor, nodes: Tensor) -> Tensor:
        """Logits of pointing at each part.

        Args:
            encoded: one row per object. hidden: (B, T, D).
            nodes: (B, T) part whose child is chosen, -1 for the root.

        Returns:
            (B, T, P).
        """
        logits = self.query(hidden) @ encoded.keys.transpose(1, 2) / 8.0
        count = encoded.keys.shape[1]
        index = nodes.clamp_min(0)[..., None].expand(-1, -1, count)
        child = encoded.bias[..., 0].gather(1, index)
        root = encoded.bias[..., 1].diagonal(dim1=1, dim2=2)[:, None]
        return logits + torch.where((nodes >= 0)[..., None], child, root)


def _whole(prompt: Prompt, count: int) -> np.ndarray:
    if prompt.whole is None:
        return whole_cloud(prompt.arrays, count)
    return np.resize(prompt.whole[:: max(1, len(prompt.whole) // count)], (count, 3))


def whole_cloud(arrays: StructureArrays, count: int) -> np.ndarray:
    """(count, 3) points of the whole object, each part by its area; deterministic."""
    area = np.maximum(arrays.scalars[:, AREA_ROOT], 1e-3) ** 2
    share = np.maximum(1, np.floor(area / area.sum() * count)).astype(int)
    share[np.argmax(share)] += max(0, count - int(share.sum()))
    rows = [p[: min(n, len(p))] for p, n in zip(arrays.points, share, strict=True)]
    points = np.concatenate(rows)
    return np.resize(points, (count, 3)).astype(np.float32)


def _mlp(inside: int, inner: int, out: int, *, normalised: bool = False) -> nn.Sequential:
    layers: list[nn.Module] = [nn.Linear(inside, inner), nn.GELU(), nn.Linear(inner, out)]
    if normalised:
        layers.append(nn.RMSNorm(out, eps=1e-6))
    return nn.Sequential(*layers)


class _Padder:
    """(sum P, …) → (B, most, …)."""

    def __init__(self, counts: Sequence[int], device: torch.device) -> None:
        most = max(counts)
        self.shape = (len(counts), most)
        index = [b * most + k for b, count in enumerate(counts) for k in range(count)]
        self.index = torch.tensor(index, device=device)

    def __call__(self, rows: Tensor) -> Tensor:
        out = rows.new_zeros((self.shape[0] * self.shape[1], *rows.shape[1:]))
        return out.index_copy(0, self.index, rows).view(*self.shape, *rows.shape[1:])


def token_tensors(
    tokens: Sequence[Token], device: torch.device | str = "cpu"
) -> tuple[Tensor, Tensor]:
    """(1, T) words and (1, T) parts."""
    return (
        torch.tensor([[f.word for f in tokens]], device=device),
        torch.tensor([[f.part for f in tokens]], device=device),
    )


SHIPPED = static_assets() / "arti4urdf"
"""The weights that come with the repository."""


def vocabulary_hash() -> str:
    """Fingerprint of the vocabulary that weights depend on."""
    return hashlib.sha256("\n".join(vocabulary.TOKENS).encode()).hexdigest()[:16]


def save_weights(
    model: ArtiModel, folder: Path, *, version: str, record: Mapping[str, Any] | None = None
) -> None:
    """Write the folder: matrices in bfloat16, and ``record`` (training, scores).

    Raises:
        InputFileError: if the folder can't be written.
    """
    config = {
        "version": version,
        "vocabulary": vocabulary_hash(),
        "model": asdict(model.config),
        "record": dict(record or {}),
    }
    save_checkpoint(folder, config, model.state_dict())


def load_weights(folder: Path = SHIPPED) -> tuple[ArtiModel, str]:
    """The model in evaluation mode, and its version.

    Raises:
        InputFileError: if a file is absent or damaged, or has another vocabulary.
    """
    found = load_checkpoint(folder)
    path = folder / "config.json"
    if found.config.get("vocabulary") != vocabulary_hash():
        raise InputFileError(
            path,
            "the weights were trained with another vocabulary",
            "train again with this version, or use the version that made them",
        )
    model = ArtiModel(from_config(ModelConfig, found.config.get("model"), path))
    strict_load(model, found.state, path)
    return model.float().eval(), str(found.config.get("version", ""))
