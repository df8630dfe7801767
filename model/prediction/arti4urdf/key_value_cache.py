"""Keys and values of a :class:`~model.prediction.arti4urdf.language_model.Decoder`, kept between
passes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import torch
from torch import Tensor
from torch.nn import functional

if TYPE_CHECKING:
    from model.prediction.arti4urdf.language_model import DecoderConfig

BLOCK = 256
"""Slots by which a cache grows."""


class KeyValueCache:
    """Keys and values of the tokens read so far, one row a sequence.

    Rows may hold tokens that don't count (the decoder's ``valid``), so that sequences
    of different lengths share a batch: such a slot is attended by nobody and takes no position.

    Args:
        config: of the decoder.
        batch: rows.
        capacity: slots to begin with; it grows by itself.
        device: where the tensors live.
        dtype: of the decoder's weights.
    """

    def __init__(
        self,
        config: DecoderConfig,
        batch: int = 1,
        *,
        capacity: int = BLOCK,
        device: torch.device | str = "cpu",
        dtype: torch.dtype = torch.float32,
    ) -> None:
        shape = (config.layers, batch, config.kv_heads, max(1, capacity), config.head_dim)
        self._keys = torch.empty(shape, device=device, dtype=dtype)
        self._values = torch.empty_like(self._keys)
        self._valid: Tensor | None = None
        self._length = 0

    @property
    def length(self) -> int:
        """Slots in use."""
        return self._length

    @property
    def batch(self) -> int:
        """Rows."""
        return self._keys.shape[1]

    def truncate(self, length: int) -> None:
        """Forget everything after the first ``length`` slots."""
        if not 0 <= length <= self._length:
            raise ValueError(f"can't cut a cache of {self._length} slots to {length}")
        self._length = length
        if self._valid is not None:
            self._valid = self._valid[:, :length]

    def reorder(self, rows: Tensor) -> None:
        """Row *i* becomes what row ``rows[i]`` was; rows may repeat, so their number may change.

        Args:
            rows: (new batch,) int64.
        """
        rows = rows.to(self._keys.device)
        if len(rows) == self.batch and bool(
            (rows == torch.arange(self.batch, device=rows.device)).all()
        ):
            return
        used = slice(0, self._length)
        keys = self._keys.new_empty((self._keys.shape[0], len(rows)) + self._keys.shape[2:])
        values = torch.empty_like(keys)
        keys[:, :, :, used] = self._keys[:, :, :, used].index_select(1, rows)
        values[:, :, :, used] = self._values[:, :, :, used].index_select(1, rows)
        self._keys, self._values = keys, values
        if self._valid is not None:
            self._valid = self._valid.index_select(0, rows)

    def copy(self) -> KeyValueCache:
        """An independent cache with the same content."""
        twin = object.__new__(KeyValueCache)
        twin._keys, twin._values = self._keys.clone(), self._values.clone()
        twin._valid, twin._length = self._valid, self._length
        return twin

    def begin(self, count: int, valid: Tensor | None) -> tuple[Tensor | None, Tensor | None]:
        """Make room for ``count`` slots; their positions and who may be attended.

        Returns:
            (B, count) positions and (B, slots) validity; None twice where every slot counts.
        """
        before = self._length
        room = self._keys.shape[3]
        if before + count > room:
            more = max(before + count - room, BLOCK, room // 2)
            self._keys = functional.pad(self._keys, (0, 0, 0, more))
            self._values = functional.pad(self._values, (0, 0, 0, more))
        self._length = before + count
        if valid is None and self._valid is None:
            return None, None
        like = {"device": self._keys.device, "dtype": torch.bool}
        old = self._valid
        if old is None:
            old = torch.ones(self.batch, before, **like)
        new = torch.ones(self.batch, count, **like) if valid is None else valid.to(**like)
        self._valid = torch.cat([old, new], dim=1)
        positions = self._valid.long().cumsum(1)[:, before:] - 1
        return positions.clamp_min(0), self._valid

    def append(self, layer: int, keys: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        """Write a layer's (B, H, T, D) into the slots :meth:`begin` made; all slots come back."""
        span = slice(self._length - keys.shape[2], self._length)
        self._keys[layer, :, :, span] = keys
        self._values[layer, :, :, span] = values
        used = slice(0, self._length)
        return self._keys[layer, :, :, used], self._values[layer, :, :, used]
