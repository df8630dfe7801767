"""Point-BERT as ULIP-2 publishes it, in pure torch, its small variant, and the adapters.

Source: Yu et al., Point-BERT (CVPR 2022); Xue et al., ULIP-2 (CVPR 2024). Names and shapes of the
parameters are those of the published checkpoints after ``module.point_encoder.`` is removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, cast

import torch
from torch import Tensor, nn
from torch.nn import functional


@dataclass(frozen=True)
class PointBertConfig:
    """Sizes and choices of a :class:`PointBert`.

    Attributes:
        width: width of a token; the output is twice as wide.
        depth: transformer blocks.
        heads: attention heads; divides ``width``.
        groups: neighbourhoods per cloud.
        neighbours: points per neighbourhood.
        encoder_width: output of the mini-PointNet.
        point_width: first layer of the mini-PointNet; its others are 2, 4 and 4 times as wide.
        points: points per cloud that the weights were trained with.
        channels: per point, xyz first.
        drop_path: largest rate of stochastic depth, reached at the last block.
        normalisation: inside the mini-PointNet. ``layer`` cannot collapse to a constant as batch
            norm did on small data.
        unit_neighbourhoods: scale every neighbourhood to a largest radius of 1.
        skip_near_origin: exclude points with |p|² ≤ 1e-3 from farthest-point sampling, as the
            CUDA sampler of the published weights does.
    """

    width: int = 384
    depth: int = 18
    heads: int = 6
    groups: int = 512
    neighbours: int = 32
    encoder_width: int = 256
    point_width: int = 128
    points: int = 10_000
    channels: int = 6
    drop_path: float = 0.1
    normalisation: Literal["batch", "layer"] = "batch"
    unit_neighbourhoods: bool = False
    skip_near_origin: bool = True

    def __post_init__(self) -> None:
        if self.width % self.heads:
            raise ValueError(f"{self.heads} heads don't divide a width of {self.width}")

    @property
    def output_width(self) -> int:
        """Width of the feature of a cloud."""
        return 2 * self.width


ULIP2 = PointBertConfig()
NANO = PointBertConfig(
    width=96,
    depth=2,
    heads=3,
    groups=16,
    neighbours=12,
    encoder_width=96,
    point_width=24,
    points=192,
    drop_path=0.0,
    normalisation="layer",
    unit_neighbourhoods=True,
    skip_near_origin=False,
)


class Groups(NamedTuple):
    """Neighbourhoods of a batch of clouds.

    Attributes:
        centers: (B, G, 3).
        neighbourhoods: (B, G, K, C); xyz relative to the centre, other channels as they were.
    """

    centers: Tensor
    neighbourhoods: Tensor


def farthest_points(xyz: Tensor, count: int, *, skip_near_origin: bool = False) -> Tensor:
    """Indices of ``count`` points, each the farthest from those before it, beginning with point 0.

    Ties go to the lower index. Once all points are chosen, point 0 is repeated.

    Args:
        xyz: (B, N, 3).
        count: points to choose.
        skip_near_origin: never choose a point with |p|² ≤ 1e-3, except the first.

    Returns:
        (B, count) int64.
    """
    xyz = xyz.detach().float()
    x, y, z = (channel.contiguous() for channel in xyz.unbind(-1))
    nearest = torch.full_like(x, torch.inf)
    if skip_near_origin:
        # Below every squared distance, so the maximum never falls on one of them.
        nearest = nearest.masked_fill(xyz.square().sum(-1) <= 1e-3, -1.0)
    chosen = torch.zeros(len(xyz), count, dtype=torch.long, device=xyz.device)
    last = chosen[:, :1]
    for step in range(1, count):
        squared = (
            (x - x.gather(1, last))
            .square_()
            .add_((y - y.gather(1, last)).square_())
            .add_((z - z.gather(1, last)).square_())
        )
        nearest = torch.minimum(nearest, squared)
        last = nearest.argmax(1, keepdim=True)
        chosen[:, step] = last[:, 0]
    return chosen


def group_points(cloud: Tensor, config: PointBertConfig) -> Groups:
    """Group clouds into neighbourhoods around farthest points. No gradient, no randomness.

    Args:
        cloud: (B, N, C), N ≥ 1, normalised by the caller. With fewer points than groups or
            neighbours, points are repeated, which doesn't change the maxima.
        config: groups, neighbours and the two options of grouping.
    """
    with torch.no_grad():
        xyz = cloud[..., :3].float()
        chosen = farthest_points(xyz, config.groups, skip_near_origin=config.skip_near_origin)
        centers = xyz.gather(1, chosen[..., None].expand(-1, -1, 3))
        distances = torch.cdist(
            centers, xyz, compute_mode="donot_use_mm_for_euclid_dist"
        )  # (B, G, N)
        neighbours = min(config.neighbours, xyz.shape[1])
        nearest = distances.topk(neighbours, largest=False).indices
        if neighbours < config.neighbours:
            missing = config.neighbours - neighbours
            nearest = torch.cat([nearest, nearest[..., :1].expand(-1, -1, missing)], dim=-1)
        rows = torch.arange(len(cloud), device=cloud.device)[:, None, None]
        points = cloud[rows, nearest]
        relative = points[..., :3].float() - centers[:, :, None]
        if config.unit_neighbourhoods:
            radius = relative.square().sum(-1).amax(-1).sqrt()
            relative = relative / radius.clamp_min(1e-6)[..., None, None]
        neighbourhoods = torch.cat([relative.to(cloud.dtype), points[..., 3:]], dim=-1)
        return Groups(centers.to(cloud.dtype), neighbourhoods)


class _PointConv(nn.Conv1d):
    """A convolution of kernel 1 in its published shape, computed as a matrix product."""

    def __init__(self, width: int, out: int) -> None:
        super().__init__(width, out, 1)

    def forward(self, input: Tensor) -> Tensor:
        return functional.linear(input, self.weight[..., 0], self.bias)


class MiniPointNet(nn.Module):
    """The feature of a neighbourhood: a point-wise network with two maxima."""

    def __init__(self, config: PointBertConfig) -> None:
        super().__init__()
        narrow, middle, wide = (config.point_width * factor for factor in (1, 2, 4))
        norm = nn.BatchNorm1d if config.normalisation == "batch" else nn.LayerNorm
        self.first_conv = nn.Sequential(
            _PointConv(config.channels, narrow),
            norm(narrow),
            nn.ReLU(),
            _PointConv(narrow, middle),
        )
        self.second_conv = nn.Sequential(
            _PointConv(wide, wide),
            norm(wide),
            nn.ReLU(),
            _PointConv(wide, config.encoder_width),
        )

    def forward(self, neighbourhoods: Tensor) -> Tensor:
        """(…, K, C) points → (…, encoder_width)."""
        *lead, neighbours, channels = neighbourhoods.shape
        local = self.first_conv(neighbourhoods.reshape(-1, channels))
        local = local.view(-1, neighbours, local.shape[-1])
        # The published layer reads cat(group maximum, point): the first half once a group.
        lift = cast(_PointConv, self.second_conv[0])
        of_group, of_point = lift.weight[..., 0].chunk(2, dim=1)
        summary = functional.linear(local.amax(1), of_group, lift.bias)
        hidden = functional.linear(local, of_point) + summary[:, None]
        features = self.second_conv[1:](hidden.flatten(0, 1))
        return features.view(*lead, neighbours, -1).amax(-2)


class _DropPath(nn.Module):
    """Stochastic depth per sample."""

    def __init__(self, rate: float) -> None:
        super().__init__()
        self.rate = rate

    def forward(self, branch: Tensor) -> Tensor:
        if not self.training or self.rate == 0.0:
            return branch
        kept = branch.new_empty(len(branch), 1, 1).bernoulli_(1.0 - self.rate)
        return branch * kept / (1.0 - self.rate)


class _Attention(nn.Module):
    def __init__(self, width: int, heads: int) -> None:
        super().__init__()
        self.heads = heads
        self.qkv = nn.Linear(width, 3 * width, bias=False)
        self.proj = nn.Linear(width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        batch, length, width = tokens.shape
        qkv = self.qkv(tokens).view(batch, length, 3, self.heads, -1).permute(2, 0, 3, 1, 4)
        mixed = functional.scaled_dot_product_attention(*qkv.unbind(0))
        return self.proj(mixed.transpose(1, 2).reshape(batch, length, width))


class _Mlp(nn.Module):
    def __init__(self, width: int) -> None:
        super().__init__()
        self.fc1 = nn.Linear(width, 4 * width)
        self.fc2 = nn.Linear(4 * width, width)

    def forward(self, tokens: Tensor) -> Tensor:
        return self.fc2(functional.gelu(self.fc1(tokens)))


class _Block(nn.Module):
    def __init__(self, config: PointBertConfig, drop_path: float) -> None:
        super().__init__()
        self.norm1 = nn.LayerNorm(config.width)
        self.attn = _Attention(config.width, config.heads)
        self.norm2 = nn.LayerNorm(config.width)
        self.mlp = _Mlp(config.width)
        self.drop_path = _DropPath(drop_path)

    def forward(self, tokens: Tensor) -> Tensor:
        tokens = tokens + self.drop_path(self.attn(self.norm1(tokens)))
        return tokens + self.drop_path(self.mlp(self.norm2(tokens)))


class _Blocks(nn.Module):
    """Holds the list, for the published names ``blocks.blocks.{i}``."""

    def __init__(self, config: PointBertConfig) -> None:
        super().__init__()
        last = max(1, config.depth - 1)
        rates = [config.drop_path * index / last for index in range(config.depth)]
        self.blocks = nn.ModuleList([_Block(config, rate) for rate in rates])

    def forward(self, tokens: Tensor, positions: Tensor) -> Tensor:
        for block in self.blocks:
            tokens = block(tokens + positions)
        return tokens


class PointBert(nn.Module):
    """Groups of a cloud → one feature of ``2 * width``: the class token and the tokens' maximum."""

    def __init__(self, config: PointBertConfig = ULIP2) -> None:
        super().__init__()
        self.config = config
        self.encoder = MiniPointNet(config)
        self.reduce_dim = nn.Linear(config.encoder_width, config.width)
        self.cls_token = nn.Parameter(torch.zeros(1, 1, config.width))
        self.cls_pos = nn.Parameter(torch.randn(1, 1, config.width) * 0.02)
        self.pos_embed = nn.Sequential(nn.Linear(3, 128), nn.GELU(), nn.Linear(128, config.width))
        self.blocks = _Blocks(config)
        self.norm = nn.LayerNorm(config.width)

    def forward(self, groups: Groups) -> Tensor:
        """(B, 2 * width) features of B clouds, from :func:`group_points`."""
        tokens = self.reduce_dim(self.encoder(groups.neighbourhoods))
        batch = len(tokens)
        tokens = torch.cat([self.cls_token.expand(batch, -1, -1), tokens], dim=1)
        positions = self.pos_embed(groups.centers)
        positions = torch.cat([self.cls_pos.expand(batch, -1, -1), positions], dim=1)
        tokens = self.norm(self.blocks(tokens, positions))
        return torch.cat([tokens[:, 0], tokens[:, 1:].amax(1)], dim=-1)


class Projector(nn.Module):
    """The two-layer adapter from geometry features to the language model's width.

    Args:
        geometry_width: of the encoder's feature. hidden_size: of the language model.
        normalised: RMS norm on the result, so that the features of a collapsing encoder can't
            hide behind the language model's embeddings (small model).
    """

    def __init__(self, geometry_width: int, hidden_size: int, *, normalised: bool = False) -> None:
        super().__init__()
        self.fc1 = nn.Linear(geometry_width, hidden_size)
        self.fc2 = nn.Linear(hidden_size, hidden_size)
        self.norm = nn.RMSNorm(hidden_size, eps=1e-6) if normalised else nn.Identity()

    def forward(self, features: Tensor) -> Tensor:
        """(…, geometry_width) → (…, hidden_size)."""
        return self.norm(self.fc2(functional.gelu(self.fc1(features))))
