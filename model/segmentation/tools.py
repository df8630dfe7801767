"""More than clicks: masks that a person asks for by other means.

Every function takes an encoded :class:`~model.segmentation.default.DefaultSession` and gives masks
over the elements (faces, or points); what to do with a mask is the caller's, usually a
:class:`~model.segmentation.prompts.Region`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.spatial import KDTree

from model.errors import PromptError
from model.segmentation.cells import groups
from model.segmentation.default import DefaultSession
from model.segmentation.prompt_steps import locate
from model.segmentation.prompts import BASE, PartSegmentation

Bool = npt.NDArray[np.bool_]
Position = Sequence[float] | npt.NDArray[np.floating]

_GAP = 3.0


def _to_elements(session: DefaultSession, nodes: Bool) -> Bool:
    return session.encoding.nodes.elements.to_elements(nodes.astype(np.int16)) > 0


def _to_nodes(session: DefaultSession, mask: Bool) -> Bool:
    mask = _checked(session, mask)
    out = np.zeros(len(session.encoding.nodes), bool)
    out[session.encoding.nodes.elements.nodes_of(np.nonzero(mask)[0])] = True
    return out


def _checked(session: DefaultSession, mask: Bool) -> Bool:
    mask = np.asarray(mask, bool)
    if mask.shape != (session.asset.element_count,):
        raise PromptError(
            f"{session.asset.name}: a mask needs shape ({session.asset.element_count},), "
            f"got {mask.shape}"
        )
    return mask


def hover(session: DefaultSession, position: Position, element: int | None = None) -> Bool:
    """(E,) what a first click at ``position`` would take; for showing under the pointer."""
    found, node = locate(session.asset, session.encoding.nodes, position, element)
    cells = session.encoding.cells
    mask = session.preview(int(cells.of_node[node]))
    out = _to_elements(session, mask[cells.of_node])
    out[found] = True
    return out


def connected(session: DefaultSession, position: Position, element: int | None = None) -> Bool:
    """(E,) everything connected with the clicked place.

    On a mesh its connected shell; on a cloud what is reached without a jump over more than three
    times the point spacing.
    """
    nodes, graph = session.encoding.nodes, session.encoding.graph
    found, node = locate(session.asset, nodes, position, element)
    near = ~graph.bridge & (graph.length <= _GAP * graph.spacing)
    near &= nodes.shell[graph.a] == nodes.shell[graph.b]
    _, piece = groups(len(nodes), graph.a[near], graph.b[near])
    inside = piece == piece[node]
    if session.asset.mesh is not None:
        inside = nodes.shell == nodes.shell[node]
    out = _to_elements(session, inside)
    out[found] = True
    return out


def pieces(session: DefaultSession, mask: Bool) -> list[Bool]:
    """The connected pieces of a mask, largest first; for splitting a part."""
    inside = _to_nodes(session, mask)
    graph = session.encoding.graph
    keep = inside[graph.a] & inside[graph.b] & ~graph.bridge
    _, piece = groups(len(inside), graph.a[keep], graph.b[keep])
    ids, counts = np.unique(piece[inside], return_counts=True)
    out = []
    for i in ids[np.argsort(-counts, kind="stable")]:
        out.append(_to_elements(session, inside & (piece == i)) & mask)
    return [m for m in out if m.any()]


def grow(session: DefaultSession, mask: Bool, steps: int = 1) -> Bool:
    """The mask widened by ``steps`` neighbours; negative steps shrink it.

    It never grows over a gap. Shrinking undoes growing but for what touched the rest.
    """
    inside = _to_nodes(session, mask)
    graph = session.encoding.graph
    a, b = graph.a[~graph.bridge], graph.b[~graph.bridge]
    for _ in range(abs(steps)):
        moving = inside if steps > 0 else ~inside
        reached = moving.copy()
        reached[b[moving[a]]] = True
        reached[a[moving[b]]] = True
        inside = reached if steps > 0 else ~reached
    out = _to_elements(session, inside)
    return out | mask if steps > 0 else out & mask


def straight_cut(
    session: DefaultSession, mask: Bool, positions: Sequence[Position]
) -> tuple[Bool, Bool]:
    """Cut a mask by a plane through two or three clicks.

    Two clicks cut along the line between them, square to the surface there: the way to part a
    door that is flush with the body. Three clicks are three points of the plane.

    Returns:
        The two sides, (E,) each; together they are ``mask``. The first holds fewer elements.

    Raises:
        PromptError: where the clicks don't fix a plane.
    """
    at = np.array([np.asarray(tuple(p), float) for p in positions])
    if len(at) not in (2, 3):
        raise PromptError(f"a straight cut needs two or three clicks, got {len(at)}")
    along = at[1] - at[0]
    if len(at) == 3:
        normal = np.cross(along, at[2] - at[0])
    else:
        _, near = session.encoding.nodes.tree.query(at)
        surface = session.encoding.graph.normals[near]
        if surface[0] @ surface[1] < 0:
            surface[1] *= -1
        normal = np.cross(along, surface.sum(0))
    length = float(np.linalg.norm(normal))
    if length < 1e-9 * max(float(along @ along), 1e-18):
        raise PromptError("the clicks of a straight cut must not lie on one another or one line")
    mask = _checked(session, mask)
    side = (session.asset.element_centers - at[0]) @ (normal / length) > 0
    first, second = mask & side, mask & ~side
    return (first, second) if first.sum() <= second.sum() else (second, first)


def mirrored(session: DefaultSession, mask: Bool, axis: int = 0) -> Bool:
    """(E,) the mask's counterpart on the other side of the object's middle.

    Args:
        axis: 0, 1, 2: the middle plane is square to x, y, z.
    """
    inside = _to_nodes(session, mask)
    points = session.encoding.nodes.points
    if not inside.any():
        return np.zeros(session.asset.element_count, bool)
    low, high = session.asset.bounds
    image = points[inside].astype(float)
    image[:, axis] = low[axis] + high[axis] - image[:, axis]
    far, _ = KDTree(image).query(points, workers=2)
    return _to_elements(session, far < 2.0 * session.encoding.graph.spacing) & ~mask


def same_shape(session: DefaultSession, mask: Bool, limit: int = 50) -> list[Bool]:
    """Other parts like this one (the other knobs, the other handles), best first.

    Regions of the merge trees with about the same size, extents and normals are laid over the
    mask (as they are, mirrored, or turned by quarters about the upright axis) and kept where
    they cover each other. No two answers overlap, and none overlaps the mask.
    """
    inside = _to_nodes(session, mask)
    cells = session.encoding.cells
    share = np.bincount(cells.of_node, inside, len(cells)) / cells.size
    model = share > 0.5
    if not model.any():
        model = share == share.max()
    want = _shape(session, model)
    found: list[tuple[float, Bool]] = []
    for candidate in _regions_of_size(session, float(cells.size[model].sum())):
        if (candidate & model).any():
            continue
        shape = _shape(session, candidate)
        if np.abs(np.log((shape + 1e-6) / (want + 1e-6))).max() > 0.35:
            continue
        fit = _fit(session, model, candidate)
        if fit < 0.25:
            found.append((fit, candidate))
    found.sort(key=lambda pair: pair[0])
    taken = model.copy()
    out: list[Bool] = []
    for _, candidate in found:
        if (candidate & taken).any():
            continue
        taken |= candidate
        out.append(_to_elements(session, candidate[cells.of_node]))
        if len(out) == limit:
            break
    return out


def _regions_of_size(session: DefaultSession, size: float) -> list[Bool]:
    """Different regions of all trees with 0.7 to 1.4 times ``size`` nodes."""
    hierarchy, cells = session.encoding.hierarchy, session.encoding.cells
    seen: set[bytes] = set()
    out = []
    for labels in hierarchy.labels:
        sizes = np.bincount(labels, cells.size)
        for region in np.nonzero((sizes > 0.7 * size) & (sizes < 1.4 * size))[0]:
            mask = labels == region
            key = np.packbits(mask).tobytes()
            if key not in seen:
                seen.add(key)
                out.append(mask)
    return out


def _shape(session: DefaultSession, mask: Bool) -> npt.NDArray[np.float64]:
    """(4,) sorted extents and the length of the mean normal: what turning does not change."""
    cells = session.encoding.cells
    x, w = cells.center[mask], cells.size[mask] / cells.size[mask].sum()
    x = x - w @ x
    values = np.linalg.eigvalsh((x * w[:, None]).T @ x)
    spread = np.sqrt(np.maximum(values, 0)) + 0.5 * session.encoding.graph.spacing
    scale = spread[2]
    return np.array([*spread, scale * (0.3 + np.linalg.norm(w @ cells.normal[mask]))])


def _fit(session: DefaultSession, model: Bool, other: Bool) -> float:
    """Mean distance between two regions laid over each other, relative to their radius."""
    center, weight = session.encoding.cells.center, session.encoding.cells.size
    a = center[model] - np.average(center[model], axis=0, weights=weight[model])
    b = center[other] - np.average(center[other], axis=0, weights=weight[other])
    radius = float(np.sqrt((a**2).sum(1).mean())) + session.encoding.graph.spacing
    tree = KDTree(a)
    best = np.inf
    for mirror in (1.0, -1.0):
        for quarter in range(4):
            c, s = [(1, 0), (0, 1), (-1, 0), (0, -1)][quarter]
            turned = np.stack(
                [mirror * (c * b[:, 0] - s * b[:, 1]), s * b[:, 0] + c * b[:, 1], b[:, 2]], axis=1
            )
            there, _ = tree.query(turned)
            back, _ = KDTree(turned).query(a)
            best = min(best, float(there.mean() + back.mean()) / 2)
    return best / radius


def propose(session: DefaultSession, seeds: int = 160, least: float = 0.55) -> PartSegmentation:
    """A first guess of all parts, to start from.

    Masks that a first click on one of many spread cells would take, best first; a small part may
    sit on a large one, other overlaps are refused. What none of them takes is the base, and so
    is the largest where it covers most of the object.

    Args:
        seeds: cells asked.
        least: score (0..1, the expected IoU squared) that a part needs.
    """
    cells = session.encoding.cells
    ranked: list[tuple[float, Bool]] = []
    for cell in _spread(cells.center, seeds):
        answer = session.solver.first_answer(int(cell))
        score = 1 / (1 + np.exp(-answer.scores))
        for index in np.argsort(-score)[:4]:
            ranked.append((float(score[index]), answer.candidates.masks[index]))
    ranked.sort(key=lambda pair: -pair[0])
    chosen: list[Bool] = []
    for score, mask in ranked:
        size = float(cells.size[mask].sum())
        shared = [float(cells.size[mask & other].sum()) for other in chosen]
        # Apart from all others, or a small part that sits on one of them: a knob on a panel.
        fits = all(
            common < 0.1 * size
            or (common > 0.9 * size and size < 0.25 * float(cells.size[other].sum()))
            for common, other in zip(shared, chosen, strict=True)
        )
        if score >= least and fits:
            chosen.append(mask)
    of_cell = np.zeros(len(cells), np.int16)
    chosen.sort(key=lambda m: -float(cells.size[m].sum()))
    if chosen and cells.size[chosen[0]].sum() > 0.4 * cells.size.sum():
        chosen = chosen[1:]
    for part, mask in enumerate(chosen, start=BASE + 1):
        of_cell[mask] = part
    labels = session.encoding.nodes.elements.to_elements(of_cell[cells.of_node])
    return PartSegmentation(labels, "default")


def _spread(points: npt.NDArray[np.float64], count: int) -> npt.NDArray[np.int64]:
    """Farthest-point sampling; starts at the first point."""
    chosen = [0]
    far = np.linalg.norm(points - points[0], axis=1)
    while len(chosen) < min(count, len(points)):
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)


def without_leftovers(
    session: DefaultSession, labels: npt.NDArray[np.int16], largest: float = 0.01
) -> npt.NDArray[np.int16]:
    """Give the crumbs to their neighbours.

    Every connected piece of one label with at most ``largest`` of all nodes, other than that
    label's largest piece, goes to the label that it touches most; so do unassigned elements.
    """
    nodes, graph = session.encoding.nodes, session.encoding.graph
    of_node = np.asarray(labels)[_first_elements(session)]
    same = (of_node[graph.a] == of_node[graph.b]) & ~graph.bridge
    number, piece = groups(len(nodes), graph.a[same], graph.b[same])
    size = np.bincount(piece, minlength=number)
    label = np.zeros(number, np.int16)
    label[piece] = of_node
    biggest = np.zeros(number, bool)
    for part in np.unique(label):
        own = np.nonzero(label == part)[0]
        biggest[own[size[own].argmax()]] = part >= 0
    crumb = ~biggest & ((size <= largest * len(nodes)) | (label < 0))
    out = of_node.copy()
    a, b = piece[graph.a], piece[graph.b]
    for here, there in ((a, b), (b, a)):
        use = crumb[here] & ~crumb[there]
        key, count = np.unique(
            here[use].astype(np.int64) * 1024 + label[there[use]], return_counts=True
        )
        order = np.argsort(count, kind="stable")
        label[key[order] // 1024] = np.where(
            crumb[key[order] // 1024], key[order] % 1024, label[key[order] // 1024]
        )
    out = np.maximum(label[piece], BASE).astype(np.int16)
    moved = nodes.elements.to_elements(out)
    unchanged = nodes.elements.to_elements((out != of_node).astype(np.int16)) == 0
    return np.where(unchanged & (np.asarray(labels) >= 0), labels, moved)


def _first_elements(session: DefaultSession) -> npt.NDArray[np.int64]:
    """(N,) one element that each node stands for."""
    elements = session.encoding.nodes.elements
    first = np.zeros(len(session.encoding.nodes), np.int64)
    if len(elements.vote_node):
        first[elements.vote_node] = elements.vote_element
    first[elements.node_of_element[::-1]] = np.arange(len(elements.node_of_element) - 1, -1, -1)
    return first
