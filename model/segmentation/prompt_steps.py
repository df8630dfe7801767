"""Prompts tied to elements and nodes, and the rule that they are honoured exactly."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.errors import PromptError
from model.segmentation.encode.nodes import Nodes
from model.segmentation.prompts import BASE, UNASSIGNED, Click, Prompts, Region


@dataclass(frozen=True, eq=False)
class ClickStep:
    """A click with the element that was clicked and the node that stands for it.

    Attributes:
        stray: whether the element lies on no surface; ``node`` is the nearest one then.
    """

    part: int
    positive: bool
    element: int
    node: int
    stray: bool = False


@dataclass(frozen=True, eq=False)
class RegionStep:
    """A region with the nodes most of whose elements it holds."""

    part: int
    positive: bool
    elements: npt.NDArray[np.int64]
    nodes: npt.NDArray[np.int32]


Step = ClickStep | RegionStep


def locate(
    asset: Asset, nodes: Nodes, position: Iterable[float], element: int | None = None
) -> tuple[int, int]:
    """Element and node of a position; the nearest element where none is named.

    Raises:
        PromptError: where ``element`` is not an element of the asset.
    """
    if element is not None and not 0 <= element < asset.element_count:
        raise PromptError(
            f"{asset.name}: {asset.element_kind} {element} is not there; "
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


def _nearest_element(
    asset: Asset, nodes: Nodes, at: npt.NDArray[np.float64], near: npt.NDArray[np.integer]
) -> int:
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
    known: dict[Click, ClickStep] | None = None,
    first_of: npt.NDArray[np.int64] | None = None,
) -> tuple[Step, ...]:
    """Tie each prompt to elements and nodes.

    Args:
        known: of clicks that were tied before; the others are added.
        first_of: (E,) the first element at the same place as each one, where some are: what is said
            of one of them is said of all. Clicks are tied to that one, regions hold all.

    Raises:
        PromptError: where a prompt names an element that the asset does not have.
    """
    known = {} if known is None else known
    steps: list[Step] = []
    for item in prompts.items:
        if isinstance(item, Click):
            if item not in known:
                known[item] = _clicked(asset, nodes, item, first_of)
            steps.append(known[item])
        else:
            steps.append(_region(asset, nodes, item, first_of))
    return tuple(steps)


def _clicked(
    asset: Asset, nodes: Nodes, click: Click, first_of: npt.NDArray[np.int64] | None
) -> ClickStep:
    element, node = locate(asset, nodes, click.position, click.element)
    if first_of is not None and first_of[element] != element:
        element, node = locate(asset, nodes, click.position, int(first_of[element]))
    return ClickStep(click.part, click.positive, element, node, nodes.elements.is_stray(element))


def telling(steps: tuple[Step, ...]) -> tuple[Step, ...]:
    """The steps that say something of surfaces, in order.

    A click on a stray point is about that point alone, but for the first one on a part: that is
    about what lies nearest.
    """
    begun = {BASE}
    told: list[Step] = []
    for step in steps:
        if isinstance(step, ClickStep) and step.stray and (not step.positive or step.part in begun):
            continue
        if step.positive:
            begun.add(step.part)
        told.append(step)
    return tuple(told)


def _region(
    asset: Asset, nodes: Nodes, item: Region, first_of: npt.NDArray[np.int64] | None
) -> RegionStep:
    if len(item.elements) and item.elements[-1] >= asset.element_count:
        raise PromptError(
            f"{asset.name}: {asset.element_kind} {int(item.elements[-1])} is not there; "
            f"it has {asset.element_count}"
        )
    elements = item.elements
    if first_of is not None:
        said = np.zeros(asset.element_count, bool)
        said[first_of[elements]] = True
        elements = np.flatnonzero(said[first_of])
    return RegionStep(item.part, item.positive, elements, nodes.elements.nodes_of(elements))


def enforce(
    labels: npt.NDArray[np.int16],
    steps: tuple[Step, ...],
    instead: npt.NDArray[np.int16],
    released: dict[int, npt.NDArray[np.bool_]] | None = None,
) -> npt.NDArray[np.int16]:
    """Put clicked elements and regions on the side where they were said to be.

    Args:
        labels: (E,) answer so far; not changed.
        steps: in order; later beats earlier.
        instead: (E,) label to take where an element must leave its part and the answer gives
            it no other (the second-best part).
        released: for the index of a region in ``steps``, elements (E,) that later clicks
            inside that region have taken from it.

    Returns:
        (E,) labels; -1 only where the base is refused and no other part is there.
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
            # Two refusals of the same element must not send it back and forth.
            gone = refused.setdefault(step.element, set())
            gone.add(step.part)
            if int(out[step.element]) in gone:
                out[step.element] = BASE if BASE not in gone else UNASSIGNED
    return out
