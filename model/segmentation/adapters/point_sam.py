"""Point-SAM behind the segmenter protocol: encode once, prompt many times; weights from a path.

The architecture is that of the published code (``PointCloudSAM`` with an EVA-02 Large encoder), and
a checkpoint must match it name by name and shape by shape. It was only tested with random weights,
so nothing is claimed about the published ones.

A part's prompts are given one after the other, each with the mask before it, as in the published
demo; other parts' clicks are its negative ones. A point that several parts claim goes to the one
with the highest logit. PyTorch is imported when an asset is encoded, not before.
"""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from cachetools import LRUCache
from scipy.spatial import KDTree

from model.core.asset import Asset
from model.core.errors import ConfigurationError, InputFileError
from model.core.files import read_safetensors, strict_load
from model.core.progress import Progress, no_progress
from model.segmentation.arrays import Bool, Float32, Float64
from model.segmentation.nodes import Nodes, nodes_of_asset
from model.segmentation.prompt_steps import ClickStep, enforce, resolve
from model.segmentation.prompts import BASE, PartSegmentation, Prompts

if TYPE_CHECKING:
    from model.segmentation.adapters.point_sam_network import Encoded, PointSamConfig

NAME = "point-sam"
POINTS = 30_000
"""Points that the network gets; the published model was trained with 10,000 to 30,000."""
_CACHED = 200
"""Prompts whose masks are cached."""
_IMAGE_PARTS = tuple(
    f"pc_encoder.transformer.{part}"
    for part in ("cls_token", "pos_embed", "patch_embed.", "rope.", "head.")
)
"""Parts of EVA-02 for images that the published checkpoint may hold; clouds don't need them."""
_REMEDY = "give model.safetensors of Point-SAM (github.com/zyc00/Point-SAM), ViT-L"

Key = tuple[tuple[int, bool], ...]


class PointSamSegmenter:
    """See :class:`~model.segmentation.registry.Segmenter`.

    Args:
        checkpoint: a ``.safetensors`` file, or the state dict of a ``.pt`` or ``.pth`` file.
        device: None for the GPU if there is one.

    Raises:
        InputFileError: if there is no such file.
    """

    name = NAME

    def __init__(self, checkpoint: str | Path, device: str | None = None) -> None:
        self._checkpoint = Path(checkpoint).expanduser()
        self._device = device
        self._network: Any = None
        if not self._checkpoint.is_file():
            raise InputFileError(self._checkpoint, "no such file", _REMEDY)

    def encode(self, asset: Asset, progress: Progress = no_progress) -> PointSamSession:
        """Encode ``asset``.

        Raises:
            ConfigurationError: if PyTorch is not installed.
            InputFileError: if the checkpoint is damaged or of another architecture.
        """
        progress(0.02, "Loading Point-SAM")
        if self._network is None:
            self._network = load_network(self._checkpoint, self._device)
        progress(0.5, "Encoding")
        return PointSamSession(asset, self._network)


def load_network(checkpoint: Path, device: str | None = None) -> Any:
    """The network with its weights; every name and shape must fit.

    Raises:
        ConfigurationError, InputFileError: see :meth:`PointSamSegmenter.encode`.
    """
    try:
        import torch
    except ImportError as error:
        raise ConfigurationError(
            "Point-SAM needs PyTorch and safetensors: pip install torch safetensors"
        ) from error
    # Imports torch at its top.
    from model.segmentation.adapters.point_sam_network import PointSamNetwork

    state = _read_state(checkpoint)
    state = {name: v for name, v in state.items() if not name.startswith(_IMAGE_PARTS)}
    network = PointSamNetwork(_config_of(state, checkpoint))
    strict_load(network, state, checkpoint, dtype=torch.float32)
    chosen = device or ("cuda" if torch.cuda.is_available() else "cpu")
    return network.eval().requires_grad_(False).to(chosen)


def _read_state(path: Path) -> dict[str, Any]:
    import torch

    if path.suffix == ".safetensors":
        return read_safetensors(path)
    try:
        # Only tensors: a pickled checkpoint must not run code.
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises many kinds for other files
        raise InputFileError(
            path, f"is no checkpoint that can be read ({error})", _REMEDY
        ) from error
    for wrapper in ("state_dict", "model"):
        if isinstance(state, dict) and isinstance(state.get(wrapper), dict):
            state = state[wrapper]
    if not isinstance(state, dict) or not all(hasattr(v, "shape") for v in state.values()):
        raise InputFileError(path, "holds no state dict", _REMEDY)
    return {name.removeprefix("module."): v for name, v in state.items()}


def _config_of(state: dict[str, Any], path: Path) -> PointSamConfig:
    """The network's sizes, from a checkpoint's tensors.

    Raises:
        InputFileError: if tensors of a known name are missing.
    """
    from model.segmentation.adapters.point_sam_network import PointSamConfig  # imports torch

    blocks = "pc_encoder.transformer.blocks."
    try:
        depth = 1 + max(int(n[len(blocks) :].split(".")[0]) for n in state if n.startswith(blocks))
        width, patch = state["pc_encoder.patch_proj.weight"].shape
        return PointSamConfig(
            width=int(width),
            depth=depth,
            hidden=int(state[f"{blocks}0.mlp.fc2.weight"].shape[1]),
            patch=int(patch),
            embed=int(state["pc_encoder.out_proj.weight"].shape[0]),
            decoder_hidden=int(state["mask_decoder.transformer.layers.0.mlp.lin1.weight"].shape[0]),
        )
    except (KeyError, ValueError, IndexError) as error:
        raise InputFileError(path, f"is no checkpoint of Point-SAM ({error})", _REMEDY) from error


class PointSamSession:
    """See :class:`~model.segmentation.registry.SegmentationSession`."""

    def __init__(self, asset: Asset, network: Any) -> None:
        import torch

        self.asset = asset
        self._network = network
        self._nodes: Nodes = nodes_of_asset(asset)
        self._device = next(network.parameters()).device
        points = self._nodes.points.astype(np.float64)
        count = len(points)
        chosen = np.arange(count)
        if count > POINTS:
            chosen = np.sort(np.random.default_rng(0).choice(count, POINTS, replace=False))
        self._shift = points[chosen].mean(0)
        away = np.linalg.norm(points[chosen] - self._shift, axis=1)
        self._scale = max(float(away.max()), 1e-9)
        self._near = np.asarray(KDTree(points[chosen]).query(points)[1], np.int64)
        colors = self._nodes.colors
        shown = np.full((len(chosen), 3), 0.5) if colors is None else colors[chosen] / 255.0
        with torch.inference_mode():
            self._cloud: Encoded = network.encode(
                self._tensor(self._normalised(points[chosen])), self._tensor(shown)
            )
        self._logits: LRUCache[Key, tuple[Float32, ...]] = LRUCache(_CACHED)

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """Labels for all elements; see the protocol."""
        begin = time.perf_counter()
        steps = resolve(self.asset, self._nodes, prompts)
        clicks = [s for s in steps if isinstance(s, ClickStep)]
        parts = list(dict.fromkeys(s.part for s in clicks if s.positive and s.part != BASE))
        zero = np.zeros(self.asset.element_count, np.int16)
        if not parts:
            labels = enforce(zero, steps, zero)
        else:
            # The base wins if no part's logit is above 0.
            wanted = [np.zeros(len(self._near), np.float32)]
            wanted += [self._answer(clicks, p)[0][self._near] for p in parts]
            order = np.argsort(-np.stack(wanted), axis=0, kind="stable")[:2]
            ids = np.array([BASE, *parts], np.int16)
            to_elements = self._nodes.elements.to_elements
            labels = enforce(to_elements(ids[order[0]]), steps, to_elements(ids[order[1]]))
        return PartSegmentation(labels, NAME, time.perf_counter() - begin)

    def candidates(self, prompts: Prompts, part: int) -> list[Bool]:
        """The other masks of the network for a part with one prompt."""
        steps = resolve(self.asset, self._nodes, prompts)
        clicks = [s for s in steps if isinstance(s, ClickStep)]
        if not any(s.part == part and s.positive for s in clicks) or part == BASE:
            return []
        out = []
        for logits in self._answer(clicks, part)[1:]:
            inside = (logits[self._near] > 0).astype(np.int16)
            mask = self._nodes.elements.to_elements(inside) > 0
            for s in clicks:
                mask[s.element] = s.positive == (s.part == part)
            out.append(mask)
        return out

    def _answer(self, clicks: list[ClickStep], part: int) -> tuple[Float32, ...]:
        """(N,) logits of the best mask, then of the others, after all prompts for ``part``."""
        key: Key = ()
        mask: Any = None
        found: tuple[Float32, ...] = ()
        for click in clicks:
            positive = click.positive and click.part == part
            if not positive and not click.positive and click.part != part:
                continue  # refused for another part: no prompt for this one
            if not key and not positive:
                continue  # a mask starts with a positive prompt
            key = (*key, (click.node, positive))
            if key not in self._logits:
                self._logits[key] = self._prompt(key, mask)
            found = self._logits[key]
            mask = found[0]
        return found

    def _prompt(self, key: Key, mask: Any) -> tuple[Float32, ...]:
        import torch

        nodes = np.array([node for node, _ in key])
        places = self._tensor(self._normalised(self._nodes.points[nodes].astype(np.float64)))
        positive = torch.tensor([p for _, p in key], device=self._device)
        with torch.inference_mode():
            logits, scores = self._network.prompt(
                self._cloud, places, positive, None if mask is None else self._tensor(mask)
            )
        best_first = torch.argsort(-scores, stable=True)
        return tuple(logits[i].float().cpu().numpy() for i in best_first)

    def _normalised(self, points: Float64) -> Float64:
        return np.clip((points - self._shift) / self._scale, -1.0, 1.0)

    def _tensor(self, values: npt.NDArray[Any]) -> Any:
        import torch

        return torch.as_tensor(np.ascontiguousarray(values, np.float32), device=self._device)
