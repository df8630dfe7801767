"""The loss: language modelling on the choices of the answer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from model.prediction.arti4urdf.network import ArtiModel
from model.training.arti4urdf.batches import Batch

TYPE_WEIGHT = 0.1
Z_WEIGHT = 1e-3
"""Keeps the logits' scale: weight of the squared log-sum-exp."""


@dataclass(frozen=True, eq=False)
class Loss:
    """Loss of one batch.

    Attributes:
        total: scalar to minimise. losses: (C,) of each decision. hits: (C,) whether the likeliest
            answer is right. kinds: (C,).
    """

    total: Tensor
    losses: Tensor
    hits: Tensor
    kinds: np.ndarray


def batch_loss(model: ArtiModel, batch: Batch) -> Loss:
    """Negative log-likelihood of the right answers, and the part tokens' own guess of the type."""

    def here(values: np.ndarray) -> Tensor:
        return torch.from_numpy(values).to(model.device)

    encoded = model.encode([e.prompt for e in batch.examples])
    hidden = model(encoded, here(batch.words), here(batch.parts), lengths=batch.lengths)
    rows, places = here(batch.rows), here(batch.places)
    nodes = torch.full(hidden.shape[:2], -1, device=model.device)
    nodes[rows, places] = here(batch.nodes)
    pointed = model.point(encoded, hidden, nodes)[rows, places]
    words = model.word_logits(hidden[rows, places])
    logits = torch.cat([words, pointed], -1)
    allowed, right = here(batch.allowed), here(batch.right)
    logits = logits.float().masked_fill(~allowed, -1e9)
    whole = logits.logsumexp(-1)
    losses = whole - logits.masked_fill(~right, -1e9).logsumexp(-1)
    hits = right.gather(1, logits.argmax(-1, keepdim=True))[:, 0]
    total = (losses + Z_WEIGHT * whole.square()).sum() / len(batch.examples) / 8
    total = total + TYPE_WEIGHT * _type_loss(model, encoded.shapes, batch)
    return Loss(total, losses.detach().cpu(), hits.cpu(), batch.kinds)


def _type_loss(model: ArtiModel, shapes: Tensor, batch: Batch) -> Tensor:
    types = np.concatenate([e.types for e in batch.examples])
    return functional.cross_entropy(
        model.type_head(shapes), torch.from_numpy(types).to(model.device)
    )


def by_kind(kinds: np.ndarray, values: Tensor) -> dict[str, float]:
    """Mean value of each kind of decision."""
    array = values.double().numpy()
    return {str(k): float(array[kinds == k].mean()) for k in np.unique(kinds)}
