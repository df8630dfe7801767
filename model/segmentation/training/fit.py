"""Fits a small perceptron with torch and hands it over as plain numpy."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.segmentation.mlp import Mlp

Float = npt.NDArray[np.floating]


def fit_mlp(
    names: tuple[str, ...],
    features: Float,
    target: Float,
    weight: Float,
    *,
    hidden: tuple[int, ...] = (32, 32),
    epochs: int = 12,
    seed: int = 0,
) -> Mlp:
    """Weighted binary cross-entropy on targets in [0, 1]; the output is a logit.

    Args:
        features: (N, D). target, weight: (N,).
    """
    import torch

    torch.manual_seed(seed)
    mean = features.mean(0)
    scale = np.maximum(features.std(0), 1e-6)
    x = torch.from_numpy(np.clip((features - mean) / scale, -8, 8).astype(np.float32))
    y, w = torch.from_numpy(target.astype(np.float32)), torch.from_numpy(weight.astype(np.float32))
    sizes = (features.shape[1], *hidden, 1)
    layers: list[torch.nn.Module] = []
    for i in range(len(sizes) - 1):
        layers += [torch.nn.Linear(sizes[i], sizes[i + 1]), torch.nn.ReLU()]
    net = torch.nn.Sequential(*layers[:-1])
    batch = 4096
    steps = epochs * (len(x) // batch + 1)
    optimizer = torch.optim.AdamW(net.parameters(), lr=5e-3, weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 5e-3, total_steps=steps)
    generator = torch.Generator().manual_seed(seed)
    for _ in range(epochs):
        order = torch.randperm(len(x), generator=generator)
        for begin in range(0, len(x), batch):
            pick = order[begin : begin + batch]
            loss = torch.nn.functional.binary_cross_entropy_with_logits(
                net(x[pick])[:, 0], y[pick], w[pick]
            )
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    linear = [m for m in net if isinstance(m, torch.nn.Linear)]
    return Mlp(
        names,
        mean.astype(np.float32),
        scale.astype(np.float32),
        tuple((m.weight.detach().numpy().copy(), m.bias.detach().numpy().copy()) for m in linear),
    )


def area_under_curve(score: Float, positive: npt.NDArray[np.bool_]) -> float:
    """Probability that a random positive scores above a random negative."""
    rank = np.empty(len(score))
    rank[np.argsort(score, kind="stable")] = np.arange(1, len(score) + 1)
    n, m = int(positive.sum()), int((~positive).sum())
    return float((rank[positive].sum() - n * (n + 1) / 2) / max(n * m, 1))
