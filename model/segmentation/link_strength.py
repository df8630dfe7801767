"""How much each link between cells looks like a border, judged with what lies around it.

The edge model sees a single edge of the node graph; whether a crease is the rim of a door or only
its relief shows in how it goes on. A small network passes messages between neighbouring cells,
and between the coarser patches that hold them, and ranks the links anew (message passing as in
Battaglia et al., *Relational inductive biases, deep learning, and graph networks*, 2018). It is
plain numpy here; :mod:`model.segmentation.training.links` trains it.
"""

from __future__ import annotations

import json
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt
from scipy.sparse import csr_matrix

from model.errors import InputFileError
from model.resources import static_assets
from model.segmentation.cells import Cells, paired
from model.segmentation.edge_strength import MAX_STRENGTH
from model.segmentation.features import FEATURE_NAMES as EDGE_FEATURES
from model.segmentation.graph import Graph
from model.segmentation.nodes import Nodes
from model.segmentation.parallel import together

WEIGHTS = "segmentation/links.npz"
FORMAT = 1

CELL_FEATURES = (
    "log_size", "flatness", "inside_strength", "log_links", "strength", "has_color",
    "log_spacing", "lightness", "red_green", "blue_yellow",
)  # fmt: skip
LINK_FEATURES = (
    *EDGE_FEATURES, "strength", "strength_max", "strength_min", "log_count", "log_length",
    "same_normal", "color_step", "hue_step", "log_smaller", "contact",
)  # fmt: skip
PATCHES = (3000, 750, 190)
"""How many patches there are on each coarser level."""
_PATCH_WEIGHT = 0.4
LIMIT = 6.0
"""Standard deviations beyond which features are cut off."""
GATE = 0.1
"""What is added to the sum of the gates of a cell, so that it may hear of nobody."""
_EVEN = 4.5
"""Strength of a link that is as likely a border as not."""

Float = npt.NDArray[np.floating]
Int = npt.NDArray[np.integer]


@dataclass(frozen=True, eq=False)
class LinkInputs:
    """What the network sees of an object.

    Attributes:
        a, b: (M,) the cells of each link.
        cell: (C, len(CELL_FEATURES)) float32.
        link: (M, len(LINK_FEATURES)) float32, the same from either side.
        along: (M, 2) float32 how far the normals of a and b point from a to b.
        patches: for each of ``PATCHES``, (C,) the patch of each cell.
    """

    a: Int
    b: Int
    cell: npt.NDArray[np.float32]
    link: npt.NDArray[np.float32]
    along: npt.NDArray[np.float32]
    patches: tuple[Int, ...]


def link_inputs(
    nodes: Nodes, graph: Graph, features: Float, strength: Float, cells: Cells
) -> LinkInputs:
    """What the network sees.

    Args:
        features: (E, len(EDGE_FEATURES)) of the edges of ``graph``.
        strength: (E,) of the same edges.
    """
    extent = float(np.linalg.norm(np.ptp(nodes.points, axis=0)))
    links, number = cells.links, len(cells)
    a, b = links.a, links.b
    mean = links.strength / np.maximum(links.count, 1)
    length = np.linalg.norm(cells.normal, axis=1)
    unit = cells.normal / np.maximum(length, 1e-6)[:, None]
    way = cells.center[b] - cells.center[a]
    apart = np.linalg.norm(way, axis=1)
    way /= np.maximum(apart, 1e-9)[:, None]
    own, other = cells.of_node[graph.a], cells.of_node[graph.b]
    inner = own == other
    held = np.maximum(np.bincount(own[inner], minlength=number), 1)
    inside = np.bincount(own[inner], strength[inner], number) / held
    ends = np.concatenate([a, b])
    degree = np.bincount(ends, minlength=number)
    around = np.bincount(ends, np.concatenate([mean, mean]), number) / np.maximum(degree, 1)
    color = cells.color / 20
    means, patches = together(
        lambda: _link_means(graph, features, strength, cells), lambda: _patches(cells)
    )
    cell = [
        np.log(cells.size),
        length,
        inside,
        np.log(degree + 1.0),
        around,
        np.full(number, float(np.ptp(cells.color) > 1e-6)),
        np.full(number, np.log(graph.spacing / max(extent, 1e-9))),
        *color.T,
    ]
    step = color[b] - color[a]
    smaller = np.minimum(cells.size[a], cells.size[b])
    link = [
        *means.T,
        np.log(links.count),
        np.log(apart / graph.spacing + 0.1),
        np.einsum("ij,ij->i", unit[a], unit[b]),
        np.linalg.norm(step, axis=1),
        np.linalg.norm(step[:, 1:], axis=1),
        np.log(smaller),
        links.count / np.sqrt(smaller),
    ]
    along = [np.einsum("ij,ij->i", unit[side], way) for side in (a, b)]
    return LinkInputs(
        a,
        b,
        np.stack([np.asarray(c, np.float32) for c in cell], axis=1),
        np.stack([np.asarray(c, np.float32) for c in link], axis=1),
        np.stack([np.asarray(c, np.float32) for c in along], axis=1),
        patches,
    )


def _link_means(graph: Graph, features: Float, strength: Float, cells: Cells) -> Float:
    """(M, D + 3) means of the node edges' features and strengths, largest and least strength."""
    number, links = len(cells), cells.links
    a = cells.of_node[graph.a].astype(np.int64)
    b = cells.of_node[graph.b].astype(np.int64)
    crossing = np.nonzero(a != b)[0]
    a, b = a[crossing], b[crossing]
    known = links.a.astype(np.int64) * number + links.b
    link = np.searchsorted(known, np.minimum(a, b) * number + np.maximum(a, b))
    order = np.argsort(link, kind="stable").astype(np.int32)
    rows = crossing[order].astype(np.int32)
    start = np.searchsorted(link[order], np.arange(len(known) + 1)).astype(np.int32)
    share = np.repeat(1 / np.diff(start), np.diff(start)).astype(np.float32)
    means = csr_matrix((share, rows, start), shape=(len(known), len(features)))
    held = strength[rows]
    extremes = [f.reduceat(held, start[:-1]) for f in (np.maximum, np.minimum)]
    return np.column_stack([means @ features, means @ strength, *extremes])


def _patches(cells: Cells) -> tuple[Int, ...]:
    """Ever coarser patches: cells paired on."""
    out: list[Int] = []
    links, size = cells.links, cells.size
    of_cell = np.arange(len(cells))
    for target in PATCHES:
        of, links, size = paired(links, size, target, _PATCH_WEIGHT)
        of_cell = of[of_cell]
        out.append(of_cell)
    return tuple(out)


Linear = tuple[npt.NDArray[np.float32], npt.NDArray[np.float32]]


@dataclass(frozen=True, eq=False)
class LinkModel:
    """The network; its layers are (weight (out, in), bias (out,)) float32 pairs by name.

    Attributes:
        mean, scale: of the features in training, by ``cell`` and ``link``.
        layers: ``cell``, ``link``, ``link_2``, ``out_1``, ``out_2``, and of each round r of
            messages ``from_r``, ``to_r``, ``over_r``, ``along_r``, ``gate_r``, ``update_r``,
            where it looks at patches ``patch_r`` and ``link_update_r`` as well.
        rounds: of messages.
    """

    mean: dict[str, npt.NDArray[np.float32]]
    scale: dict[str, npt.NDArray[np.float32]]
    layers: dict[str, Linear]

    @property
    def rounds(self) -> int:
        """Rounds of messages."""
        return sum(name.startswith("from_") for name in self.layers)

    def __call__(self, x: LinkInputs) -> npt.NDArray[np.float32]:
        """(M,) logits: how much each link looks like a border."""
        number, count = len(x.cell), len(x.a)
        if not count:
            return np.zeros(0, np.float32)
        one, at = np.ones(count, np.float32), np.arange(count)
        into = {
            "a": csr_matrix((one, (x.a, at)), shape=(number, count)),
            "b": csr_matrix((one, (x.b, at)), shape=(number, count)),
        }
        held = np.bincount(np.concatenate([x.a, x.b]), minlength=number)
        degree = np.maximum(held, 1).astype(np.float32)[:, None]
        h = _relu(self._linear("cell", self._scaled("cell", x.cell)))
        e = _relu(self._linear("link", self._scaled("link", x.link)))
        e = _relu(self._linear("link_2", e))
        pools = [_Pool(p) for p in x.patches]
        for r in range(self.rounds):
            sent, got = self._linear(f"from_{r}", h), self._linear(f"to_{r}", h)
            over = self._linear(f"over_{r}", e)
            gate = 1 / (1 + np.exp(-self._linear(f"gate_{r}", e)))
            forth, back = together(
                lambda: self._message(r, sent[x.a], got[x.b], over, x.along),  # noqa: B023
                lambda: self._message(r, sent[x.b], got[x.a], over, -x.along[:, ::-1]),  # noqa: B023
            )
            plain = into["b"] @ forth + into["a"] @ back
            chosen = into["b"] @ (forth * gate) + into["a"] @ (back * gate)
            open_ = into["b"] @ gate + into["a"] @ gate + np.float32(GATE)
            told = [h, plain / degree, chosen / open_]
            if f"patch_{r}" in self.layers:
                seen = _relu(self._linear(f"patch_{r}", h))
                told += [pool(seen) for pool in pools]
                both = np.concatenate([e, forth + back], axis=1)
                e = e + _relu(self._linear(f"link_update_{r}", both))
            h = h + _relu(self._linear(f"update_{r}", np.concatenate(told, axis=1)))
        ends = np.concatenate([h[x.a] + h[x.b], np.abs(h[x.a] - h[x.b]), e], axis=1)
        return self._linear("out_2", _relu(self._linear("out_1", ends)))[:, 0]

    def _message(self, r: int, sent: Float, got: Float, over: Float, along: Float) -> Float:
        return _relu(sent + got + over + self._linear(f"along_{r}", along))

    def _scaled(self, name: str, x: Float) -> Float:
        return np.clip((x - self.mean[name]) / self.scale[name], -LIMIT, LIMIT)

    def _linear(self, name: str, x: Float) -> npt.NDArray[np.float32]:
        weight, bias = self.layers[name]
        return x @ weight.T + bias


def _relu(x: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
    return np.maximum(x, 0, out=x)


class _Pool:
    """Means over the patches, given back to the cells."""

    def __init__(self, patch: Int) -> None:
        number = int(patch.max()) + 1
        share = (1 / np.bincount(patch, minlength=number)[patch]).astype(np.float32)
        self._patch = patch
        self._means = csr_matrix(
            (share, (patch, np.arange(len(patch)))), shape=(number, len(patch))
        )

    def __call__(self, values: npt.NDArray[np.float32]) -> npt.NDArray[np.float32]:
        return (self._means @ values)[self._patch]


def refined(cells: Cells, logit: Float) -> Cells:
    """``cells`` with links as strong as (M,) ``logit`` says."""
    links = cells.links
    mean = links.strength / np.maximum(links.count, 1)
    strength = np.clip(np.asarray(logit, np.float64) + _EVEN, 0, MAX_STRENGTH)
    return replace(
        cells,
        links=replace(
            links,
            strength=strength * links.count,
            conductance=links.conductance * np.exp(mean - strength),
        ),
    )


@lru_cache(maxsize=1)
def shipped_link_model() -> LinkModel | None:
    """The trained model that ships with the project, or None where it is not there."""
    path = static_assets() / WEIGHTS
    return load_link_model(path) if path.is_file() else None


def save_link_model(model: LinkModel, path: Path, config: dict[str, object]) -> None:
    """Write ``model`` as npz with the training configuration and scores beside the numbers."""
    arrays: dict[str, npt.NDArray] = {
        "format": np.array(FORMAT),
        "names": np.array((*CELL_FEATURES, *LINK_FEATURES)),
        "config": np.array(json.dumps(config, sort_keys=True)),
    }
    for name in model.mean:
        arrays[f"mean/{name}"] = model.mean[name]
        arrays[f"scale/{name}"] = model.scale[name]
    for name, (weight, bias) in model.layers.items():
        arrays[f"weight/{name}"] = weight
        arrays[f"bias/{name}"] = bias
    np.savez_compressed(path, **arrays)  # type: ignore[arg-type]


def load_link_model(path: Path) -> LinkModel:
    """Read what :func:`save_link_model` wrote.

    Raises:
        InputFileError: where the file is absent, newer, or made for other features.
    """
    if not path.is_file():
        raise InputFileError(path, "not there", "train it: python -m model.segmentation.training")
    with np.load(path, allow_pickle=False) as data:
        if int(data["format"]) != FORMAT:
            raise InputFileError(path, f"format {int(data['format'])}, this version reads {FORMAT}")
        if tuple(str(n) for n in data["names"]) != (*CELL_FEATURES, *LINK_FEATURES):
            raise InputFileError(path, "made for other features", "train it again")
        kinds = {k: {n.split("/")[1]: data[n] for n in data.files if n.startswith(f"{k}/")}
                 for k in ("mean", "scale", "weight", "bias")}  # fmt: skip
    layers = {name: (weight, kinds["bias"][name]) for name, weight in kinds["weight"].items()}
    return LinkModel(kinds["mean"], kinds["scale"], layers)
