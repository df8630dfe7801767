"""The adapters from geometry to the language model's width."""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional


class Projector(nn.Module):
    """Two-layer MLP; the global cloud and the parts have an instance each.

    Args:
        geometry_width: of the encoder's feature.
        hidden_size: of the language model.
        inner_size: of the layer between; ``hidden_size`` by default.
        normalised: RMS norm on the result, so that features of a collapsing encoder can't hide
            behind the language model's embeddings (small model).
    """

    def __init__(
        self,
        geometry_width: int,
        hidden_size: int,
        *,
        inner_size: int | None = None,
        normalised: bool = False,
    ) -> None:
        super().__init__()
        inner_size = inner_size or hidden_size
        self.fc1 = nn.Linear(geometry_width, inner_size)
        self.fc2 = nn.Linear(inner_size, hidden_size)
        self.norm = nn.RMSNorm(hidden_size, eps=1e-6) if normalised else nn.Identity()

    def forward(self, features: Tensor) -> Tensor:
        """(…, geometry_width) → (…, hidden_size)."""
        return self.norm(self.fc2(functional.gelu(self.fc1(features))))
