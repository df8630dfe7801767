"""Point-SAM's network in plain PyTorch, with the names of its published checkpoint.

Zhou, Gu, Chiang, Xiang, Su: *Point-SAM: Promptable 3D Segmentation Model for Point Clouds*, ICLR
2025. The points are grouped into patches, a PointNet turns each patch into a token, an EVA-02
transformer (without its image parts) encodes the tokens once; each prompt runs only SAM's two-way
decoder. Farthest points, neighbours and attention are written with PyTorch's own operations, so
that no compiled extension is needed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn
from torch.nn.functional import relu, scaled_dot_product_attention, silu

EVA_HEAD = 64
DECODER_HEADS = 8
MASKS = 4
"""Masks of the decoder: one for many prompts, three for a single one."""


@dataclass(frozen=True)
class PointSamConfig:
    """Sizes of the network; the defaults are the published ones.

    Attributes:
        width: of the transformer; depth: its blocks; hidden: inside its feed-forward layers.
        patch: features of a patch before the transformer.
        embed: of the encoder's output and of the decoder.
        decoder_hidden: inside the decoder's feed-forward layers.
        groups: patches; group_size: points of each.
    """

    width: int = 1024
    depth: int = 24
    hidden: int = 2730
    patch: int = 512
    embed: int = 256
    decoder_hidden: int = 2048
    groups: int = 512
    group_size: int = 64


@dataclass(frozen=True)
class Encoded:
    """A cloud encoded once.

    Attributes:
        points: (N, 3) in [-1, 1].
        centers: (G, 3); neighbors: (G, K) points of each patch.
        tokens: (G, D) the encoder's output.
        index, weight: (N, 3) the nearest centres of each point, and weights of their tokens.
    """

    points: Tensor
    centers: Tensor
    neighbors: Tensor
    tokens: Tensor
    index: Tensor
    weight: Tensor


class PointSamNetwork(nn.Module):
    """Encode once (:meth:`encode`), prompt many times (:meth:`prompt`)."""

    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        self.config = config
        self.pc_encoder = _CloudEncoder(config)
        self.point_encoder = _PointEncoder(config.embed)
        self.mask_encoder = _MaskEncoder(config.embed)
        self.mask_decoder = _MaskDecoder(config)

    def encode(self, points: Tensor, colors: Tensor) -> Encoded:
        """Encode (N, 3) points in the unit ball with (N, 3) colours in [0, 1]."""
        count = len(points)
        centers = points[farthest_points(points, min(self.config.groups, count))]
        neighbors = _nearest(centers, points, min(self.config.group_size, count))
        tokens = self.pc_encoder(points, colors, centers, neighbors)
        index = _nearest(points, centers, min(3, len(centers)))
        apart = (points[:, None] - centers[index]).square().sum(-1)
        weight = 1.0 / apart.clamp(min=1e-8)
        return Encoded(
            points, centers, neighbors, tokens, index, weight / weight.sum(1, keepdim=True)
        )

    def prompt(
        self, cloud: Encoded, places: Tensor, positive: Tensor, mask: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        """Masks for one part.

        Args:
            places: (P, 3) clicked places in [-1, 1]; positive: (P,) booleans.
            mask: (N,) logits of the mask before, or None for the first prompt.

        Returns:
            (M, N) logits and (M,) expected IoUs: three masks for a first prompt, else one.
        """
        sparse = self.point_encoder(places, positive)
        dense = self.mask_encoder(mask, cloud)
        position = self.point_encoder.pe_layer(cloud.centers)
        return self.mask_decoder(cloud, position, sparse, dense, mask is None)


def farthest_points(points: Tensor, count: int) -> Tensor:
    """(count,) indices by farthest-point sampling, from the first point on."""
    chosen = torch.zeros(count, dtype=torch.long, device=points.device)
    far = torch.full((len(points),), math.inf, device=points.device)
    for k in range(1, count):
        far = torch.minimum(far, (points - points[chosen[k - 1]]).square().sum(-1))
        chosen[k] = far.argmax()
    return chosen


def _nearest(query: Tensor, key: Tensor, k: int, chunk: int = 4096) -> Tensor:
    """(Q, k) indices of the nearest keys."""
    found = [
        torch.cdist(part, key).topk(k, dim=1, largest=False).indices for part in query.split(chunk)
    ]
    return torch.cat(found)


class _PatchEncoder(nn.Module):
    """A PointNet over each patch."""

    def __init__(self, channels: int, out: int) -> None:
        super().__init__()
        self.conv1 = nn.Sequential(
            nn.Linear(channels, 128), nn.LayerNorm(128), nn.GELU(), nn.Linear(128, 128)
        )
        self.conv2 = nn.Sequential(
            nn.Linear(256, 512), nn.LayerNorm(512), nn.GELU(), nn.Linear(512, out)
        )

    def forward(self, patches: Tensor) -> Tensor:
        x = self.conv1(patches)
        whole = x.max(dim=-2, keepdim=True).values
        x = self.conv2(torch.cat([whole.expand_as(x), x], dim=-1))
        return x.max(dim=-2).values


class _PatchEmbed(nn.Module):
    def __init__(self, out: int) -> None:
        super().__init__()
        self.patch_encoder = _PatchEncoder(6, out)


class _CloudEncoder(nn.Module):
    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        self.patch_embed = _PatchEmbed(config.patch)
        self.patch_proj = nn.Linear(config.patch, config.width)
        self.pos_embed = nn.Sequential(nn.Linear(3, 128), nn.GELU(), nn.Linear(128, config.width))
        self.transformer = _Eva(config)
        self.out_proj = nn.Linear(config.width, config.embed)

    def forward(self, points: Tensor, colors: Tensor, centers: Tensor, neighbors: Tensor) -> Tensor:
        patches = torch.cat([points[neighbors] - centers[:, None], colors[neighbors]], dim=-1)
        x = self.patch_proj(self.patch_embed.patch_encoder(patches)) + self.pos_embed(centers)
        return self.out_proj(self.transformer(x))


class _Eva(nn.Module):
    """EVA-02's blocks and last norm; its image embedding and its head are not used."""

    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        self.blocks = nn.ModuleList(_EvaBlock(config) for _ in range(config.depth))
        self.fc_norm = nn.LayerNorm(config.width, eps=1e-6)

    def forward(self, x: Tensor) -> Tensor:
        for block in self.blocks:
            x = block(x)
        return self.fc_norm(x)


class _EvaBlock(nn.Module):
    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.width, eps=1e-6)
        self.attn = _EvaAttention(config.width)
        self.norm2 = nn.LayerNorm(config.width, eps=1e-6)
        self.mlp = _SwiGlu(config.width, config.hidden)

    def forward(self, x: Tensor) -> Tensor:
        x = x + self.attn(self.norm1(x))
        return x + self.mlp(self.norm2(x))


class _EvaAttention(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.heads = max(1, width // EVA_HEAD)
        self.q_proj = nn.Linear(width, width)
        self.k_proj = nn.Linear(width, width, bias=False)
        self.v_proj = nn.Linear(width, width)
        self.proj = nn.Linear(width, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.proj(_attend(self.q_proj(x), self.k_proj(x), self.v_proj(x), self.heads))


class _SwiGlu(nn.Module):
    def __init__(self, width: int, hidden: int) -> None:
        super().__init__()
        self.fc1_g = nn.Linear(width, hidden)
        self.fc1_x = nn.Linear(width, hidden)
        self.norm = nn.LayerNorm(hidden, eps=1e-6)
        self.fc2 = nn.Linear(hidden, width)

    def forward(self, x: Tensor) -> Tensor:
        return self.fc2(self.norm(silu(self.fc1_g(x)) * self.fc1_x(x)))


def _attend(q: Tensor, k: Tensor, v: Tensor, heads: int) -> Tensor:
    """(Q, D) softmax attention of Q queries to K keys, split into heads."""
    q, k, v = (x.unflatten(-1, (heads, -1)).transpose(0, 1)[None] for x in (q, k, v))
    return scaled_dot_product_attention(q, k, v)[0].transpose(0, 1).flatten(1)


class _Frequencies(nn.Module):
    """Random Fourier features of places in [-1, 1]."""

    positional_encoding_gaussian_matrix: Tensor

    def __init__(self, count: int) -> None:
        super().__init__()
        self.register_buffer("positional_encoding_gaussian_matrix", torch.randn(3, count))

    def forward(self, places: Tensor) -> Tensor:
        turns = 2 * math.pi * (places @ self.positional_encoding_gaussian_matrix)
        return torch.cat([turns.sin(), turns.cos()], dim=-1)


class _PointEncoder(nn.Module):
    def __init__(self, embed: int) -> None:
        super().__init__()
        self.pe_layer = _Frequencies(embed // 2)
        self.point_embeddings = nn.ModuleList(nn.Embedding(1, embed) for _ in range(2))

    def forward(self, places: Tensor, positive: Tensor) -> Tensor:
        kind = torch.cat([e.weight for e in self.point_embeddings])  # type: ignore[arg-type]
        return self.pe_layer(places) + kind[positive.long()]


class _MaskEncoder(nn.Module):
    def __init__(self, embed: int) -> None:
        super().__init__()
        self.patch_encoder = _PatchEncoder(4, embed)
        self.no_mask_embed = nn.Embedding(1, embed)

    def forward(self, mask: Tensor | None, cloud: Encoded) -> Tensor:
        if mask is None:
            return self.no_mask_embed.weight.expand(len(cloud.centers), -1)
        near = cloud.points[cloud.neighbors] - cloud.centers[:, None]
        return self.patch_encoder(torch.cat([near, mask[cloud.neighbors][..., None]], dim=-1))


class _Attention(nn.Module):
    def __init__(self, embed: int, shrink: int) -> None:
        super().__init__()
        inner = embed // shrink
        self.q_proj, self.k_proj = nn.Linear(embed, inner), nn.Linear(embed, inner)
        self.v_proj, self.out_proj = nn.Linear(embed, inner), nn.Linear(inner, embed)

    def forward(self, q: Tensor, k: Tensor, v: Tensor) -> Tensor:
        q, k, v = self.q_proj(q), self.k_proj(k), self.v_proj(v)
        return self.out_proj(_attend(q, k, v, DECODER_HEADS))


class _FeedForward(nn.Module):
    def __init__(self, embed: int, hidden: int) -> None:
        super().__init__()
        self.lin1, self.lin2 = nn.Linear(embed, hidden), nn.Linear(hidden, embed)

    def forward(self, x: Tensor) -> Tensor:
        return self.lin2(relu(self.lin1(x)))


class _TwoWayBlock(nn.Module):
    """Prompts attend to themselves and to the cloud, then the cloud attends to the prompts."""

    def __init__(self, config: PointSamConfig, first: bool) -> None:
        super().__init__()
        embed = config.embed
        self.first = first
        self.self_attn = _Attention(embed, 1)
        self.cross_attn_token_to_image = _Attention(embed, 2)
        self.mlp = _FeedForward(embed, config.decoder_hidden)
        self.cross_attn_image_to_token = _Attention(embed, 2)
        self.norm1, self.norm2 = nn.LayerNorm(embed), nn.LayerNorm(embed)
        self.norm3, self.norm4 = nn.LayerNorm(embed), nn.LayerNorm(embed)

    def forward(
        self, x: Tensor, cloud: Tensor, x_pos: Tensor, cloud_pos: Tensor
    ) -> tuple[Tensor, Tensor]:
        if self.first:
            x = self.norm1(self.self_attn(x, x, x))
        else:
            q = x + x_pos
            x = self.norm1(x + self.self_attn(q, q, x))
        keys = cloud + cloud_pos
        x = self.norm2(x + self.cross_attn_token_to_image(x + x_pos, keys, cloud))
        x = self.norm3(x + self.mlp(x))
        cloud = self.norm4(cloud + self.cross_attn_image_to_token(keys, x + x_pos, x))
        return x, cloud


class _TwoWay(nn.Module):
    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        self.layers = nn.ModuleList(_TwoWayBlock(config, k == 0) for k in range(2))
        self.final_attn_token_to_image = _Attention(config.embed, 2)
        self.norm_final_attn = nn.LayerNorm(config.embed)

    def forward(self, cloud: Tensor, cloud_pos: Tensor, tokens: Tensor) -> tuple[Tensor, Tensor]:
        x = tokens
        for layer in self.layers:
            x, cloud = layer(x, cloud, tokens, cloud_pos)
        x = x + self.final_attn_token_to_image(x + tokens, cloud + cloud_pos, cloud)
        return self.norm_final_attn(x), cloud


class _Mlp(nn.Module):
    def __init__(self, width: int, hidden: int, out: int) -> None:
        super().__init__()
        sizes = (width, hidden, hidden, out)
        self.layers = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise(sizes))

    def forward(self, x: Tensor) -> Tensor:
        *inner, last = self.layers
        for layer in inner:
            x = relu(layer(x))
        return last(x)


class _MaskDecoder(nn.Module):
    def __init__(self, config: PointSamConfig) -> None:
        super().__init__()
        embed = config.embed
        self.transformer = _TwoWay(config)
        self.iou_token = nn.Embedding(1, embed)
        self.mask_tokens = nn.Embedding(MASKS, embed)
        self.output_hypernetworks_mlps = nn.ModuleList(
            _Mlp(embed, embed, embed) for _ in range(MASKS)
        )
        self.output_upscaling = nn.Sequential(
            nn.Linear(embed, embed),
            nn.LayerNorm(embed),
            nn.GELU(),
            nn.Linear(embed, embed),
            nn.GELU(),
        )
        self.iou_prediction_head = _Mlp(embed, 256, MASKS)

    def forward(
        self, cloud: Encoded, position: Tensor, sparse: Tensor, dense: Tensor, several: bool
    ) -> tuple[Tensor, Tensor]:
        tokens = torch.cat([self.iou_token.weight, self.mask_tokens.weight, sparse])
        out, source = self.transformer(cloud.tokens + dense, position, tokens)
        mixed = (source[cloud.index] * cloud.weight[..., None]).sum(1)
        features = self.output_upscaling(mixed)
        wanted = range(1, MASKS) if several else range(1)
        rows = [self.output_hypernetworks_mlps[i](out[1 + i]) for i in wanted]
        scores = self.iou_prediction_head(out[0])
        return torch.stack(rows) @ features.T, scores[wanted.start : wanted.stop]
