"""Assemble the solver of an input domain: proposal sources, describer, scorers, penalties.

To add a proposal source, write a class with the members of :class:`.ProposalSource` and list it in
:func:`object_solver` or :func:`room_solver`.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from model.segmentation.arrays import Float, Int
from model.segmentation.describe.objects import HISTORY_FEATURES, ObjectDescriber
from model.segmentation.describe.rooms import RoomDescriber
from model.segmentation.encode.encoding import Encoding
from model.segmentation.encode.hierarchy import Hierarchy
from model.segmentation.encode.random_walk import RandomWalk
from model.segmentation.encode.superpoints import Superpoints
from model.segmentation.models.trees import Scorer
from model.segmentation.parallel import together
from model.segmentation.propose.box_grid import BoxGrid
from model.segmentation.propose.box_ranking import BoxRanker, shipped_box_model
from model.segmentation.propose.boxes import Boxes, Shells
from model.segmentation.propose.fronts import FrontRectangles, Fronts
from model.segmentation.propose.proposals import ProposalSource
from model.segmentation.propose.regions import Regions
from model.segmentation.propose.room_boxes import RoomBoxes
from model.segmentation.score.moving_parts import MovingPartScoring
from model.segmentation.score.penalties import Penalties
from model.segmentation.score.scorers import Scorers
from model.segmentation.solver import PartSolver


def solver_of(
    encoding: Encoding,
    first: Scorer | None,
    later: Scorer | None,
    moving: Scorers = (None, None),
    *,
    with_fronts: bool = False,
) -> PartSolver:
    """The solver of an encoded object or room.

    Args:
        first, later: scorers of clicks that may mean the base, too.
        moving: scorers of clicks that mean a moving part.
        with_fronts: lay out fronts on meshes, too. For clicks, their faces and shells separate
            parts better.
    """
    superpoints, hierarchy, walk = encoding.superpoints, encoding.hierarchy, encoding.walk
    if encoding.room is not None:
        describe = RoomDescriber(superpoints, hierarchy, encoding.room)
        regions = Regions(superpoints, hierarchy)
        return PartSolver(
            superpoints, hierarchy, walk, first, later, describe=describe, regions=regions,
            sources=(RoomBoxes(superpoints, encoding.room, regions),),
            penalties=Penalties.for_room(),
        )  # fmt: skip
    nodes, graph, strength = encoding.nodes, encoding.graph, encoding.strength
    shell = None
    if nodes.of_mesh:
        shell = np.zeros(len(superpoints), np.int32)
        shell[superpoints.of_node] = nodes.shell

    def fronts_along(axes: Float) -> Fronts:
        return Fronts(nodes, graph, strength, superpoints, axes)

    return object_solver(
        superpoints, hierarchy, walk, first, later, shell=shell, of_mesh=nodes.of_mesh,
        fronts_along=fronts_along if with_fronts or not nodes.of_mesh else None, moving=moving,
    )  # fmt: skip


def object_solver(
    superpoints: Superpoints,
    hierarchy: Hierarchy,
    walk: RandomWalk,
    first: Scorer | None,
    later: Scorer | None,
    *,
    shell: Int | None = None,
    axes: Float | None = None,
    of_mesh: bool = False,
    fronts_along: Callable[[Float], Fronts] | None = None,
    moving: Scorers = (None, None),
) -> PartSolver:
    """The solver of superpoints of an object.

    Args:
        shell: (C,) the shell of each superpoint of a mesh; None also for a part of one.
        axes: (3, 3) main directions, if known.
        of_mesh: whether the superpoints lie on faces.
        fronts_along: lays out fronts for given main directions.
        moving: scorers of moving parts, used with fronts.
    """
    grid = BoxGrid(superpoints, axes)
    planes, describe = together(
        lambda: grid.between_planes(superpoints),
        lambda: ObjectDescriber(superpoints, hierarchy, grid),
    )
    describe.with_history = later is None or not set(HISTORY_FEATURES).isdisjoint(later.names)
    regions = Regions(superpoints, hierarchy)
    shells = None
    if shell is not None and len(np.unique(shell)) > 1:
        shells = Shells(shell, superpoints.size)
    # On meshes faces separate parts better: there the network made later clicks worse.
    model = shipped_box_model() if shell is None else None
    ranker = BoxRanker(planes, grid.place, grid.facing, grid.step, model)
    sources: list[ProposalSource] = [Boxes(grid, ranker, regions, shells, shell is not None)]
    moving_parts = None
    if fronts_along is not None:
        fronts = fronts_along(grid.axes)
        sources.append(FrontRectangles(fronts, grid, shells))
        moving_parts = MovingPartScoring(fronts, superpoints, grid.axes, *moving)
    local = len(superpoints) >= superpoints.size.sum()
    return PartSolver(
        superpoints, hierarchy, walk, first, later, describe=describe, regions=regions,
        sources=tuple(sources), moving_parts=moving_parts, axes=grid.axes,
        penalties=Penalties.for_object(of_mesh=of_mesh or shell is not None, local=local),
    )  # fmt: skip
