"""The hybrid without one of its mechanisms, to measure what each is worth: ``without:NAME``."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from dataclasses import replace
from importlib import import_module
from typing import Any
from unittest.mock import Mock, patch

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.errors import ConfigurationError
from model.core.joint import Joint
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.choosing import HybridSettings
from model.prediction.arti4urdf.predictor import Arti4UrdfPredictor, hybrid

RULES_ALONE = replace(HybridSettings(), weight=1000.0)
"""Geometry's weight with which the network's reading no longer counts."""

SWITCHES: dict[str, dict[str, Any]] = {
    "network": {},
    "names": {"roles.named_mechanism": None},
    "usual motions of a category": {"roles.CATEGORY_BONUS": 0.0},
    "front": {"mechanisms.front_of": lambda assembly, _: (assembly.front, 0.0)},
    "contact with other parts": {"tree._holder": None},
    "leaves of one front": {"tree._leaves_apart": lambda sampled, root, parent: parent},
    "chains": {"tree.chain_plane": None, "edge_hinges._chain_proposals": []},
    "handles": {"edge_hinges._handle_cue": 0.0},
    "barrels": {"edge_hinges._barrels": None},
    "ajar panels": {"edge_hinges._ajar": 0.0},
    "adjacent panels": {"edge_hinges._sibling_beyond": False},
    "sliding past": {"motion_scores.passes_sibling": False},
    "drop-down doors": {"motion_scores._top_bar": 0.0},
    "bails": {"motion_scores._bail": (0.0, 0.0)},
    "pins at ends": {"revolute._end_pivots": []},
    "swept ranges": {"mechanisms.SWEPT_LIMITS": {}},
    "shut panels start at zero": {"limits.from_zero": lambda _, motion: motion},
    "usual stops": {"context.usual_stop": float("inf")},
}
"""Mechanism → names in :mod:`model.prediction.geometric`, and their replacements: a function that
is called instead of one, or the value that one returns or a constant has."""


class WithoutMechanism:
    """The hybrid predictor with one switch of :data:`SWITCHES` off."""

    def __init__(self, mechanism: str) -> None:
        if mechanism not in SWITCHES:
            there = ", ".join(SWITCHES)
            raise ConfigurationError(f"no mechanism {mechanism!r} to leave out; there are {there}")
        self.name = f"without:{mechanism}"
        self._changes = SWITCHES[mechanism]
        settings = RULES_ALONE if mechanism == "network" else HybridSettings()
        self._hybrid = Arti4UrdfPredictor(hybrid().model, name=self.name, hybrid=settings)

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.registry.Predictor`."""
        with ExitStack() as stack:
            for place, value in self._changes.items():
                file, _, name = place.partition(".")
                original = getattr(import_module(f"model.prediction.geometric.{file}"), name)
                if isinstance(original, dict):
                    stack.enter_context(patch.dict(original, value, clear=True))
                    continue
                constant = callable(original) and not callable(value)
                new = Mock(return_value=value) if constant else value
                for key, module in list(sys.modules.items()):
                    ours = key.startswith("model.prediction")
                    if ours and vars(module).get(name) is original:
                        stack.enter_context(patch.object(module, name, new))
            return self._hybrid.predict(segmented, locked=locked, seed=seed, progress=progress)
