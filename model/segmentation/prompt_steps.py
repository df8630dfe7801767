"""Tie prompts to elements and nodes, and enforce them exactly on the finished labels."""

from __future__ import annotations

from collections.abc import Iterable, MutableMapping
from dataclasses import dataclass

import numpy as np

from model.core.asset import Asset
from model.core.errors import PromptError
from model.segmentation.arrays import Bool, Float64, Int, Int16, Int32, Int64
from model.segmentation.nodes import Nodes
from model.segmentation.prompts import BASE, UNASSIGNED, Click, Prompts, Region


@dataclass(frozen=True, eq=False)
class ClickStep:
    """A click with the clicked element and the node that stands for it.

    Attributes:
        outlier: whether the element lies on no surface; ``node`` is then the nearest one.
    """

    part: int
    positive: bool
    element: int
    node: int
    outlier: bool = False


@dataclass(frozen=True, eq=False)
class RegionStep:
    """A region and the nodes that have most of their elements in it."""

    part: int
    positive: bool
    elements: Int64
    nodes: Int32


Step = ClickStep | RegionStep


def locate(
    asset: Asset, nodes: Nodes, position: Iterable[float], element: int | None = None
) -> tuple[int, int]:
    """Element and node at a position; without ``element`` the nearest element.

    Raises:
        PromptError: if ``element`` is not an element of the asset.
    """
    if element is not None and not 0 <= element < asset.element_count:
        raise PromptError(
            f"{asset.name}: no {asset.element_kind} {element}; "
            f"it has {asset.element_count} (0..{asset.element_count - 1})"
        )
    at = np.asarray(tuple(position), np.float64)
    k = min(16, len(nodes))
    _, near = nodes.tree.query(at, k=k)
    near = np.atleast_1d(near)
    if element is None:
        element = _nearest_element(asset, nodes, at, near)
    own = np.array([element in nodes.elements.elements_of(near[i : i + 1]) for i in range(k)])
    node = int(near[own.argmax()]) if own.any() else int(nodes.elements.node_of_element[element])
    return element, node


def _nearest_element(asset: Asset, nodes: Nodes, at: Float64, near: Int) -> int:
    around = nodes.elements.elements_of(near)
    if asset.mesh is None:
        assert asset.cloud is not None
        gap = asset.cloud.points[around] - at
    else:
        from trimesh.triangles import closest_point  # pyright: ignore[reportMissingImports]

        triangles = asset.mesh.triangles[around]
        gap = closest_point(triangles, np.tile(at, (len(around), 1))) - at
    return int(around[np.einsum("ij,ij->i", gap, gap).argmin()])


def resolve(
    asset: Asset,
    nodes: Nodes,
    prompts: Prompts,
    known: MutableMapping[Click, ClickStep] | None = None,
    first_of: Int64 | None = None,
) -> tuple[Step, ...]:
    """Tie each prompt to elements and nodes.

    Args:
        known: steps of clicks that were resolved before; new ones are added.
        first_of: (E,) the first of the elements that coincide with each one, or None. Clicks are
            tied to the first, regions hold all that coincide.

    Raises:
        PromptError: if a prompt names an element that the asset doesn't have.
    """
    known = {} if known is None else known
    steps: list[Step] = []
    for item in prompts.items:
        if isinstance(item, Click):
            if item not in known:
                known[item] = _click_step(asset, nodes, item, first_of)
            steps.append(known[item])
        else:
            steps.append(_region_step(asset, nodes, item, first_of))
    return tuple(steps)


def _click_step(asset: Asset, nodes: Nodes, click: Click, first_of: Int64 | None) -> ClickStep:
    element, node = locate(asset, nodes, click.position, click.element)
    if first_of is not None and first_of[element] != element:
        element, node = locate(asset, nodes, click.position, int(first_of[element]))
    return ClickStep(click.part, click.positive, element, node, nodes.elements.is_outlier(element))


def surface_steps(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """The steps that concern surfaces, in order.

    A click on an outlier changes that point alone, except the first click of a part: it selects
    the surface nearest to it.
    """
    started = {BASE}
    out: list[Step] = []
    for step in steps:
        if (
            isinstance(step, ClickStep)
            and step.outlier
            and (not step.positive or step.part in started)
        ):
            continue
        if step.positive:
            started.add(step.part)
        out.append(step)
    return tuple(out)


def _region_step(asset: Asset, nodes: Nodes, item: Region, first_of: Int64 | None) -> RegionStep:
    if len(item.elements) and item.elements[-1] >= asset.element_count:
        raise PromptError(
            f"{asset.name}: no {asset.element_kind} {int(item.elements[-1])}; "
            f"it has {asset.element_count}"
        )
    elements = item.elements
    if first_of is not None:
        chosen = np.zeros(asset.element_count, bool)
        chosen[first_of[elements]] = True
        elements = np.flatnonzero(chosen[first_of])
    return RegionStep(item.part, item.positive, elements, nodes.elements.nodes_of(elements))


def enforce(
    labels: Int16, steps: tuple[Step, ...], instead: Int16, released: dict[int, Bool] | None = None
) -> Int16:
    """Give clicked elements and regions exactly the part that the prompts demand.

    Args:
        labels: (E,) labels so far; not changed.
        steps: in order; later beats earlier.
        instead: (E,) label of an element that must leave its part and has no other one in
            ``labels`` (the second-best part).
        released: by the index of a region in ``steps``, the elements (E,) that later clicks
            inside that region have taken from it.

    Returns:
        (E,) labels; -1 only where the base is refused and there is no other part.
    """
    out = labels.copy()
    refused: dict[int, set[int]] = {}
    for index, step in enumerate(steps):
        if isinstance(step, ClickStep):
            where = np.array([step.element])
        else:
            where = step.elements
            if released is not None and index in released:
                where = where[~released[index][where]]
        if step.positive:
            out[where] = step.part
            refused.pop(step.element, None) if isinstance(step, ClickStep) else None
            continue
        inside = where[out[where] == step.part]
        other = labels[inside]
        other = np.where((other > BASE) & (other != step.part), other, instead[inside])
        fallback = BASE if step.part != BASE else UNASSIGNED
        out[inside] = np.where(other == step.part, fallback, other)
        if isinstance(step, ClickStep):
            # Refusals of two parts must not send an element back and forth between them.
            parts = refused.setdefault(step.element, set())
            parts.add(step.part)
            if int(out[step.element]) in parts:
                out[step.element] = BASE if BASE not in parts else UNASSIGNED
    return out
