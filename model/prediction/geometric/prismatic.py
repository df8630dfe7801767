"""Prismatic proposals: drawers, sliding panels and blades, lids that lift, buttons."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from model.prediction.builder import Reason
from model.prediction.geometric.context import JointProposal, PartContext, unit
from model.prediction.geometric.limits import TOLERANCE, free_range

Array = npt.NDArray[np.float64]

DRAWER_TRAVEL = 0.79
"""Travel of a drawer over its depth; the rest stays in the rails."""


def slide_out_proposals(context: PartContext) -> list[JointProposal]:
    """A drawer slides out of the open side of its parent."""
    shape, base = context.shape, context.parent_shape
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
        score = 1.8 * (1 - covers[k]) + 0.9 * covers[(k + 3) % 6] + 1.0 * edge
        score += 0.8 * certainty * float(direction @ front)
        score += 0.3 * float(direction @ unit(shape.center - base.center))
        depth = _drawer_depth(context, direction)
        reasons = (Reason.OPEN_SIDE,) if covers[k] < 0.3 else ()
        travel = DRAWER_TRAVEL * depth
        found.append(
            JointProposal("prismatic", direction, shape.center, 0.0, travel, score, reasons=reasons)
        )
    return found


def _drawer_depth(context: PartContext, direction: Array) -> float:
    """Depth of the drawer; estimated from its parent if only the front was scanned or modelled."""
    own = 2 * context.shape.box.reach(direction)
    behind = 2 * context.parent_shape.box.reach(direction)
    if context.shape.scanned and own < 0.4 * behind:
        return 0.8 * behind
    # A front without a drawer: half the parent's depth.
    return own if own > 0.25 * behind else max(own, 0.5 * behind)


def slide_along_proposals(context: PartContext) -> list[JointProposal]:
    """A panel or blade slides within its own plane, preferably along the parent."""
    shape, base = context.shape, context.parent_shape
    _, middle, long = shape.order
    axes = shape.box.axes
    found = []
    for k in (middle, long):
        for sign in (-1.0, 1.0):
            direction = sign * axes[:, k]
            free = free_range(
                context.sampled,
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
            # Sliding doors and sashes move horizontally, blades along their handle.
            level = 1.0 - abs(direction[2])
            score = 1.2 * free / wanted + 0.5 * along + 0.4 * away
            if shape.panel.normal != int(np.argmax(np.abs(axes[2]))):
                score += 0.8 * level
            if k == long and shape.slenderness < 0.45:
                score += 1.5
            if {"lid", "cap", "cover", "blade"} & set(context.words):
                score += 1.0 * along
            travel, reasons = 0.8 * wanted, (Reason.OWN_PLANE,)
            found.append(
                JointProposal(
                    "prismatic", direction, shape.center, 0.0, travel, score, reasons=reasons
                )
            )
    return found


def lift_proposals(context: PartContext) -> list[JointProposal]:
    """A lid or plunger moves along its vertical axis, a toaster's lever downwards."""
    up = context.upright()
    height = 2 * context.shape.box.reach(up)
    travel = {"kitchenpot": 0.012, "bottle": 0.06, "suitcase": 0.75 * height, "kettle": 0.12}.get(
        context.category, 0.035 if context.shape.roundest is not None else max(0.03, 0.5 * height)
    )
    down = context.category == "toaster"
    axis = -up if down else up
    if down:
        travel = 0.5 * 2 * context.parent_shape.box.reach(up)
    center, reasons = context.shape.center, (Reason.UPRIGHT,)
    return [JointProposal("prismatic", axis, center, 0.0, travel, 1.0, reasons=reasons)]


def press_proposals(context: PartContext) -> list[JointProposal]:
    """A button moves into the surface around it."""
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
    normal_weight = 2.0 if shape.scanned else 1.2
    for (direction, (ahead, behind)), reach, thin in zip(choices, sides, flat, strict=True):
        score = 1.2 * behind - 1.2 * ahead + thin * (0.5 if shape.scanned else 1.0)
        if len(normals):
            score += normal_weight * float(np.mean(np.abs(normals @ direction)))
        if shape.scanned:
            score += 1.0 * float(np.mean(np.abs(shape.normals @ direction)))
        score += 0.5 * float(direction @ surface)
        score += 0.15 * float(direction @ context.assembly.front) + 0.1 * max(0.0, direction[2])
        travel = float(np.clip(0.6 * 2 * reach, 0.002, 0.02))
        reasons = (Reason.INTO_SURFACE,)
        found.append(
            JointProposal(
                "prismatic", -direction, shape.center, 0.0, travel, score, reasons=reasons
            )
        )
    return found


def _covered(context: PartContext) -> list[tuple[float, float]]:
    """For each of the part's directions: coverage in front, and behind."""
    covers = context.covers
    return [(float(covers[k]), float(covers[(k + 3) % 6])) for k in range(6)]


def _surface_normal(normals: Array) -> Array | None:
    """(3,) the direction shared by most of the normals; None if they don't agree."""
    if len(normals) < 6:
        return None
    values, vectors = np.linalg.eigh(normals.T @ normals / len(normals))
    return vectors[:, 2] if values[2] > 0.75 else None


def _parent_normals(context: PartContext) -> Array:
    """(K, 3) normals of the parent's surface around the part."""
    sampled, shape = context.sampled, context.shape
    reach = max(0.6 * shape.size, 0.03)
    index = sampled.tree(context.parent).query_ball_point(shape.center, reach)
    return context.parent_shape.normals[np.asarray(index, int)]


def _surface_center(context: PartContext) -> Array:
    """(3,) centre of the parent's surface around the part; of the parent if none is near."""
    sampled, shape = context.sampled, context.shape
    reach = max(0.8 * shape.size, 0.04)
    index = sampled.tree(context.parent).query_ball_point(shape.center, reach)
    if len(index) < 4:
        return context.parent_shape.center
    return context.parent_shape.points[np.asarray(index, int)].mean(0)
