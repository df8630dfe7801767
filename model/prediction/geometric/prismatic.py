"""Parts that slide: drawers, sliding panels and blades, lids that lift, buttons."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.prediction.geometric.context import PartContext
from model.prediction.geometric.hypothesis import Hypothesis, unit
from model.prediction.geometric.shape import fit_panel
from model.prediction.geometric.sweep import TOLERANCE, free_range

Array = npt.NDArray[np.float64]

DRAWER_TRAVEL = 0.79
"""Of a drawer's depth: what people leave in the rails."""


def slide_out_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A drawer leaves through the side where nothing is in front of it."""
    shape, base = context.shape, context.base
    covers = context.covers
    found = []
    front, certainty = context.assembly.front, context.assembly.front_certainty
    for k, direction in enumerate(context.directions):
        if abs(direction[2]) > 0.5:
            continue
        ends = base.outline @ direction
        end = float(np.quantile(ends, 0.99))
        own = float(shape.center @ direction) + shape.box.reach(direction)
        reach = max(base.box.reach(direction), 1e-3)
        edge = float(np.clip((own - end) / (0.5 * reach), -1.5, 0.3))
        axis_k = k % 3
        handle = _handle_beyond(context, axis_k, direction)
        score = 1.8 * (1 - covers[k]) + 0.9 * covers[(k + 3) % 6] + 1.0 * edge + 0.8 * handle
        score += 0.8 * certainty * float(direction @ front)
        score += 0.3 * float(direction @ unit(shape.center - base.center))
        depth = _drawer_depth(context, direction)
        note = "drawer: open side" if covers[k] < 0.3 else "drawer"
        found.append(
            Hypothesis(
                "prismatic", direction, shape.center, 0.0, DRAWER_TRAVEL * depth, score, note
            )
        )
    return found


def _handle_beyond(context: PartContext, k: int, direction: Array) -> float:
    """1 where a handle sticks out that way, -1 where one does the other way."""
    panel = fit_panel(context.shape, k)
    sign = float(np.sign(context.shape.box.axes[:, k] @ direction))
    out = 0.0
    for side in (1.0, -1.0):
        found = panel.beyond(sign * side)
        if found is not None and found.share < 0.12:
            out += side
    return out


def _drawer_depth(context: PartContext, direction: Array) -> float:
    """Depth of the drawer; what the body leaves for it where only its front is there."""
    own = 2 * context.shape.box.reach(direction)
    behind = 2 * context.base.box.reach(direction)
    if context.shape.scanned and own < 0.4 * behind:
        return 0.8 * behind
    # A front without a drawer behind it: half the body is left for one.
    return own if own > 0.25 * behind else max(own, 0.5 * behind)


def slide_along_hypotheses(context: PartContext) -> list[Hypothesis]:
    """A panel or blade moves within its own plane, along the parent where it can."""
    shape, base = context.shape, context.base
    _, middle, long = shape.order
    axes = shape.box.axes
    found = []
    for k in (middle, long):
        for sign in (-1.0, 1.0):
            direction = sign * axes[:, k]
            free = free_range(
                context.scene,
                context.part,
                (context.parent,),
                rotates=False,
                axis=direction,
                origin=shape.center,
                stop=min(1.0, 2 * float(shape.box.half[k])),
                tolerance=TOLERANCE,
            )
            wanted = max(1e-6, min(1.0, 2 * float(shape.box.half[k])))
            along = float(abs(base.box.axes[:, base.order[2]] @ direction))
            away = float(direction @ unit(shape.center - base.center))
            # Sliding doors and sashes move level; blades move along the handle.
            level = 1.0 - abs(direction[2])
            score = 1.2 * free / wanted + 0.5 * along + 0.4 * away
            if shape.panel.normal != int(np.argmax(np.abs(axes[2]))):
                score += 0.8 * level
            if k == long and shape.slenderness < 0.45:
                score += 1.5
            if {"lid", "cap", "cover", "blade"} & set(context.words):
                score += 1.0 * along
            note = "slides within its own plane"
            found.append(
                Hypothesis("prismatic", direction, shape.center, 0.0, 0.8 * wanted, score, note)
            )
    return found


def lift_hypotheses(context: PartContext) -> list[Hypothesis]:
    """Straight up (or along the part's own upright axis)."""
    up = context.upright()
    height = 2 * context.shape.box.reach(up)
    travel = {"kitchenpot": 0.012, "bottle": 0.06, "suitcase": 0.75 * height, "kettle": 0.12}.get(
        context.category, 0.035 if context.shape.roundest is not None else max(0.03, 0.5 * height)
    )
    down = context.category == "toaster"
    axis = -up if down else up
    if down:
        travel = 0.5 * 2 * context.base.box.reach(up)
    return [Hypothesis("prismatic", axis, context.shape.center, 0.0, travel, 1.0, "moves upright")]


def press_hypotheses(context: PartContext) -> list[Hypothesis]:
    """Into the surface that the button sits on."""
    shape = context.shape
    found = []
    normals = _parent_normals(context)
    choices = [(d, c) for d, c in zip(context.directions, _covered(context), strict=True)]
    local = _surface_normal(normals)
    if local is not None and np.abs(context.directions @ local).max() < 0.995:
        for d in (local, -local):
            near = int(np.argmax(context.directions @ d))
            choices.append((d, choices[near][1]))
    surface = unit(shape.center - _surface_center(context))
    sides = np.abs(shape.box.axes.T @ np.stack([d for d, _ in choices]).T).T @ shape.box.half
    flat = 1 - sides / max(float(sides.max()), 1e-9)
    sure = 2.0 if shape.scanned else 1.2
    for (direction, (ahead, behind)), reach, thin in zip(choices, sides, flat, strict=True):
        score = 1.2 * behind - 1.2 * ahead + thin * (0.5 if shape.scanned else 1.0)
        if len(normals):
            score += sure * float(np.mean(np.abs(normals @ direction)))
        if shape.scanned:
            score += 1.0 * float(np.mean(np.abs(shape.normals @ direction)))
        score += 0.5 * float(direction @ surface)
        score += 0.15 * float(direction @ context.assembly.front) + 0.1 * max(0.0, direction[2])
        travel = float(np.clip(0.6 * 2 * reach, 0.002, 0.02))
        note = "pressed into its surface"
        found.append(Hypothesis("prismatic", -direction, shape.center, 0.0, travel, score, note))
    return found


def _covered(context: PartContext) -> list[tuple[float, float]]:
    """For each of the part's directions: what is in front, and what is behind."""
    covers = context.covers
    return [(float(covers[k]), float(covers[(k + 3) % 6])) for k in range(6)]


def _surface_normal(normals: Array) -> Array | None:
    """(3,) the direction that most of the normals share; None where they don't agree."""
    if len(normals) < 6:
        return None
    values, vectors = np.linalg.eigh(normals.T @ normals / len(normals))
    return vectors[:, 2] if values[2] > 0.75 else None


def _parent_normals(context: PartContext) -> Array:
    """(K, 3) normals of the parent's surface around the part."""
    scene, shape = context.scene, context.shape
    reach = max(0.6 * shape.size, 0.03)
    index = scene.tree(context.parent).query_ball_point(shape.center, reach)
    return context.base.normals[np.asarray(index, int)]


def _surface_center(context: PartContext) -> Array:
    """(3,) middle of the parent's surface around the part; of the parent where none is near."""
    scene, shape = context.scene, context.shape
    reach = max(0.8 * shape.size, 0.04)
    index = scene.tree(context.parent).query_ball_point(shape.center, reach)
    if len(index) < 4:
        return context.base.center
    return context.base.points[np.asarray(index, int)].mean(0)
