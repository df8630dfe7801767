"""Qwen3's decoder in pure torch, with the parameter names of its published checkpoints.

Source: Qwen3 Technical Report (2025) and the architecture in transformers, against which the tests
compare it. In addition its cache takes spans of any length in one pass and can be cut back.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn
from torch.nn import functional

BLOCK = 256
"""Tokens by which a cache and the table of rotary angles grow."""


@dataclass(frozen=True)
class DecoderConfig:
    """Sizes of a :class:`Decoder`.

    Attributes:
        vocab_size: rows of the embedding.
        hidden_size: width of a token.
        intermediate_size: width inside the feed-forward layer.
        layers: decoder layers.
        heads: query heads.
        kv_heads: key and value heads; divides ``heads``.
        head_dim: width of a head; even.
        rope_theta: base of the rotary angles.
        rms_eps: added to the mean square in every RMS norm.
        tied: the embedding is the output matrix as well.
    """

    vocab_size: int
    hidden_size: int
    intermediate_size: int
    layers: int
    heads: int
    kv_heads: int
    head_dim: int = 128
    rope_theta: float = 1e6
    rms_eps: float = 1e-6
    tied: bool = True

    def __post_init__(self) -> None:
        if self.heads % self.kv_heads:
            raise ValueError(f"{self.kv_heads} key heads don't divide {self.heads} heads")
        if self.head_dim % 2:
            raise ValueError(f"a head width of {self.head_dim} can't be rotated in pairs")


QWEN3 = {
    "0.6b": DecoderConfig(151_936, 1024, 3072, 28, 16, 8),
    "1.7b": DecoderConfig(151_936, 2048, 6144, 28, 16, 8),
    "4b": DecoderConfig(151_936, 2560, 9728, 36, 32, 8),
    "8b": DecoderConfig(151_936, 4096, 12288, 36, 32, 8, tied=False),
}
"""The published sizes."""


class KeyValueCache:
    """Keys and values of the tokens read so far, one row per sequence.

    Args:
        config: of the decoder.
        batch: rows.
        capacity: tokens it has room for at first; it grows when needed.
        like: a tensor with the device and type of the decoder's weights.
    """

    def __init__(self, config: DecoderConfig, batch: int, capacity: int, like: Tensor) -> None:
        shape = (config.layers, batch, config.kv_heads, max(1, capacity), config.head_dim)
        self._keys = torch.empty(shape, device=like.device, dtype=like.dtype)
        self._values = torch.empty_like(self._keys)
        self.length = 0

    def truncate(self, length: int) -> None:
        """Forget all tokens after the first ``length``."""
        if not 0 <= length <= self.length:
            raise ValueError(f"can't cut a cache of {self.length} tokens to {length}")
        self.length = length

    def reserve(self, count: int) -> None:
        """Make room for ``count`` more tokens and count them as read."""
        room = self._keys.shape[3]
        if self.length + count > room:
            more = max(self.length + count - room, BLOCK, room // 2)
            self._keys = functional.pad(self._keys, (0, 0, 0, more))
            self._values = functional.pad(self._values, (0, 0, 0, more))
        self.length += count

    def append(self, layer: int, keys: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        """Write a layer's (B, H, T, D) into the reserved room and return those of all tokens."""
        span = slice(self.length - keys.shape[2], self.length)
        self._keys[layer, :, :, span] = keys
        self._values[layer, :, :, span] = values
        used = slice(0, self.length)
        return self._keys[layer, :, :, used], self._values[layer, :, :, used]


@dataclass(frozen=True)
class _Pass:
    """Tensors that all layers of one forward pass share.

    Attributes:
        cosine: (1, 1, T, head_dim) in the weights' type.
        sine: as ``cosine``; negated in its first half, for :func:`_rotate`.
        mask: (1, 1, T, S) bool or None; True may be attended.
        causal: the diagonal is the only mask.
        cache: None in training.
    """

    cosine: Tensor
    sine: Tensor
    mask: Tensor | None
    causal: bool
    cache: KeyValueCache | None


def _rotate(heads: Tensor, shared: _Pass) -> Tensor:
    """Rotary position: pairs (i, i + head_dim / 2), as Qwen3 has them."""
    low, high = heads.chunk(2, dim=-1)
    return heads * shared.cosine + torch.cat([high, low], dim=-1) * shared.sine


def _attend(queries: Tensor, keys: Tensor, values: Tensor, shared: _Pass) -> Tensor:
    """(B, heads, T, D) queries over (B, kv_heads, S, D) keys → (B, heads, T, D)."""
    batch, heads, count, width = queries.shape
    kv_heads = keys.shape[1]
    group = heads // kv_heads
    if shared.causal:
        if group > 1:
            keys = keys.repeat_interleave(group, dim=1)
            values = values.repeat_interleave(group, dim=1)
        return functional.scaled_dot_product_attention(queries, keys, values, is_causal=True)
    # The heads that share keys become rows of one query, so the cache is read without a copy.
    folded = queries.reshape(batch, kv_heads, group * count, width)
    mask = shared.mask
    if mask is not None and group > 1:
        mask = mask.repeat(1, 1, group, 1)
    mixed = functional.scaled_dot_product_attention(folded, keys, values, attn_mask=mask)
    return mixed.reshape(batch, heads, count, width)


class _Attention(nn.Module):
    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.head_dim = config.head_dim
        queries, keys = config.heads * config.head_dim, config.kv_heads * config.head_dim
        self.q_proj = nn.Linear(config.hidden_size, queries, bias=False)
        self.k_proj = nn.Linear(config.hidden_size, keys, bias=False)
        self.v_proj = nn.Linear(config.hidden_size, keys, bias=False)
        self.o_proj = nn.Linear(queries, config.hidden_size, bias=False)
        self.q_norm = nn.RMSNorm(config.head_dim, eps=config.rms_eps)
        self.k_norm = nn.RMSNorm(config.head_dim, eps=config.rms_eps)

    def forward(self, hidden: Tensor, shared: _Pass, layer: int) -> Tensor:
        batch, count, _ = hidden.shape
        split = (batch, count, -1, self.head_dim)
        queries = _rotate(self.q_norm(self.q_proj(hidden).view(split)).transpose(1, 2), shared)
        keys = _rotate(self.k_norm(self.k_proj(hidden).view(split)).transpose(1, 2), shared)
        values = self.v_proj(hidden).view(split).transpose(1, 2)
        if shared.cache is not None:
            keys, values = shared.cache.append(layer, keys, values)
        mixed = _attend(queries, keys, values, shared)
        return self.o_proj(mixed.transpose(1, 2).reshape(batch, count, -1))


class _Mlp(nn.Module):
    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.gate_proj = nn.Linear(config.hidden_size, config.intermediate_size, bias=False)
        self.up_proj = nn.Linear(config.hidden_size, config.intermediate_size, bias=False)
        self.down_proj = nn.Linear(config.intermediate_size, config.hidden_size, bias=False)

    def forward(self, hidden: Tensor) -> Tensor:
        return self.down_proj(functional.silu(self.gate_proj(hidden)) * self.up_proj(hidden))


class _Layer(nn.Module):
    def __init__(self, config: DecoderConfig, index: int) -> None:
        super().__init__()
        self.index = index
        self.self_attn = _Attention(config)
        self.mlp = _Mlp(config)
        self.input_layernorm = nn.RMSNorm(config.hidden_size, eps=config.rms_eps)
        self.post_attention_layernorm = nn.RMSNorm(config.hidden_size, eps=config.rms_eps)

    def forward(self, hidden: Tensor, shared: _Pass) -> Tensor:
        hidden = hidden + self.self_attn(self.input_layernorm(hidden), shared, self.index)
        return hidden + self.mlp(self.post_attention_layernorm(hidden))


class _Body(nn.Module):
    """Everything but the output matrix, under the published names ``model.…``."""

    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.embed_tokens = nn.Embedding(config.vocab_size, config.hidden_size)
        self.layers = nn.ModuleList([_Layer(config, index) for index in range(config.layers)])
        self.norm = nn.RMSNorm(config.hidden_size, eps=config.rms_eps)


class Decoder(nn.Module):
    """A causal language model over embeddings."""

    def __init__(self, config: DecoderConfig) -> None:
        super().__init__()
        self.config = config
        self.model = _Body(config)
        self.lm_head = (
            None if config.tied else nn.Linear(config.hidden_size, config.vocab_size, bias=False)
        )
        self._angles: tuple[Tensor, Tensor] | None = None
        for module in self.modules():
            if isinstance(module, nn.Linear | nn.Embedding):
                nn.init.normal_(module.weight, std=0.02)

    def embed(self, ids: Tensor) -> Tensor:
        """(B, T) token ids → (B, T, hidden_size)."""
        return self.model.embed_tokens(ids)

    def new_cache(self, batch: int = 1, *, capacity: int = BLOCK) -> KeyValueCache:
        """An empty cache on the device and in the type of the weights."""
        return KeyValueCache(self.config, batch, capacity, like=self.model.norm.weight)

    def forward(self, embeds: Tensor, *, cache: KeyValueCache | None = None) -> Tensor:
        """Hidden states after the final norm.

        Args:
            embeds: (B, T, hidden_size). Padding may only stand at the right; its result is
                meaningless.
            cache: tokens read before; the new ones are appended to it.

        Returns:
            (B, T, hidden_size).
        """
        shared = self._prepare(embeds, cache)
        hidden = embeds
        for layer in self.model.layers:
            hidden = layer(hidden, shared)
        return self.model.norm(hidden)

    def logits(self, hidden: Tensor) -> Tensor:
        """(…, hidden_size) → (…, vocab_size)."""
        if self.lm_head is None:
            return functional.linear(hidden, self.model.embed_tokens.weight)
        return self.lm_head(hidden)

    def _prepare(self, embeds: Tensor, cache: KeyValueCache | None) -> _Pass:
        count = embeds.shape[1]
        before = 0 if cache is None else cache.length
        if cache is not None:
            cache.reserve(count)
        cosine, sine = self._rotation(embeds, before, before + count)
        if before == 0 or count == 1:
            return _Pass(cosine, sine, None, before == 0, cache)
        places = torch.arange(before + count, device=embeds.device)
        mask = (places <= places[before:, None])[None, None]
        return _Pass(cosine, sine, mask, False, cache)

    def _rotation(self, like: Tensor, begin: int, end: int) -> tuple[Tensor, Tensor]:
        """Cosine and signed sine of positions ``begin:end``."""
        table = self._angles
        if table is None or len(table[0]) < end or table[0].device != like.device:
            self._angles = table = self._angle_table(max(end, 2 * BLOCK), like.device)
        cosine, sine = (part[None, None, begin:end] for part in table)
        return cosine.to(like.dtype), sine.to(like.dtype)

    # Tensors made in inference mode can't be used for training afterwards.
    @torch.inference_mode(False)
    def _angle_table(self, length: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """(length, head_dim) cosine and signed sine in float32, at least twice the last table.

        Not a buffer: converting the model to bfloat16 must not round the angles.
        """
        if self._angles is not None:
            length = max(length, 2 * len(self._angles[0]))
        half = torch.arange(0, self.config.head_dim, 2, dtype=torch.float32)
        frequency = self.config.rope_theta ** -(half / self.config.head_dim)
        angle = torch.outer(torch.arange(length, dtype=torch.float32), frequency)
        cosine = torch.cat([angle.cos(), angle.cos()], dim=-1)
        sine = torch.cat([-angle.sin(), angle.sin()], dim=-1)
        return cosine.to(device), sine.to(device)
