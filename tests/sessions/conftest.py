"""Values that the session tests share."""

from pathlib import Path

import numpy as np
import pytest

from model.core.articulated_object import Prediction
from model.core.joint import Joint, Mimic
from model.core.tree import KinematicTree
from sessions.store import Store
from tests.sessions.people import add_people


@pytest.fixture
def store(tmp_path: Path):
    out = Store(tmp_path / "workspace")
    yield out
    out.close()


@pytest.fixture
def people(store: Store):
    add_people(store)
    return store.people


@pytest.fixture
def cabinet() -> KinematicTree:
    """base - door - handle, base - drawer, base - knob that follows the drawer."""
    return KinematicTree(
        ("link_0", "link_1", "link_2", "link_3", "link_4"),
        (
            Joint("hinge", "revolute", "link_0", "link_1", (0, 0, 1), (0.5, 0.0, 0.0), 0.0, 1.5),
            Joint("turn", "revolute", "link_1", "link_2", (0, 1, 0), (0.1, 0.2, 0.3), -0.5, 0.5),
            Joint("slide", "prismatic", "link_0", "link_3", (0, 1, 0), (0.0, 0.0, 0.0), 0.0, 0.4),
            Joint("spin", "continuous", "link_0", "link_4", (1, 0, 0), mimic=Mimic("slide", 2.0)),
        ),
    )


@pytest.fixture
def prediction(cabinet: KinematicTree) -> Prediction:
    return Prediction(
        cabinet,
        problems=("the knob is small",),
        confidence={"link_1": 0.9, "link_3": 0.5},
        backend="geometric 1",
        seed=3,
        seconds=0.25,
        notes={"link_1": "contact line"},
    )


@pytest.fixture
def labels_ref(store: Store) -> str:
    return store.put_array(np.repeat(np.arange(5, dtype=np.int16), 10))
