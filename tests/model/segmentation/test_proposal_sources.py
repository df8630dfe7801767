"""What every proposal source promises."""

import numpy as np
import pytest

from model.core.asset import Asset
from model.data.simulated.rooms import scanned_room
from model.segmentation.boxes import Boxes, RoomBoxes
from model.segmentation.encoding import encode
from model.segmentation.fronts import FrontRectangles
from model.segmentation.graph import shipped_edge_model
from model.segmentation.proposals import BOX_SOURCE, PartState, Proposals, Regions
from model.segmentation.solver import PartSolver, solver_of


@pytest.fixture(scope="module")
def solvers(cloud_cabinet, mesh_cabinet) -> dict[str, PartSolver]:
    assets = {
        "cloud": cloud_cabinet.asset,
        "mesh": mesh_cabinet.asset,
        "room": Asset("room", cloud=scanned_room(90_001, 30_000).cloud),
    }
    encoded = {name: encode(asset, shipped_edge_model()) for name, asset in assets.items()}
    return {name: solver_of(encoding, None, None) for name, encoding in encoded.items()}


def test_each_domain_has_its_sources(solvers) -> None:
    kinds = {name: [type(s) for s in solver.sources] for name, solver in solvers.items()}
    assert kinds == {
        "cloud": [Regions, Boxes, FrontRectangles],
        "mesh": [Regions, Boxes],
        "room": [Regions, RoomBoxes],
    }


@pytest.mark.parametrize("domain", ["cloud", "mesh", "room"])
def test_sources_propose_the_same_masks_again(solvers, domain: str) -> None:
    solver = solvers[domain]
    count = len(solver.superpoints)
    clicked, other = count // 3, count // 2
    before = PartState((clicked,), (), solver.regions.nested(clicked).masks[0])
    assert before.mask is not None
    for source in solver.sources:
        assert isinstance(source.moving_only, bool)
        for positive in (True, False):
            after = before.with_click(other, positive)
            once, again = (
                source.first(clicked, (other,)) + source.later(before, after, other, positive)
                for _ in range(2)
            )
            assert len(once) == len(again)
            for one, same in zip(once, again, strict=True):
                assert isinstance(one, Proposals)
                assert one.masks.shape == (len(one), count) and one.masks.dtype == bool
                assert ((one.source >= 0) & (one.source <= BOX_SOURCE)).all()
                assert np.array_equal(one.masks, same.masks)
