"""The port that every predictor fits, and all predictors in one table."""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.joint import Joint
from model.core.packages import Registry
from model.core.progress import Progress, no_progress
from model.prediction import DEFAULT, is_backend


@runtime_checkable
class Predictor(Protocol):
    """Parts in, kinematic tree out."""

    name: str

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """Predict the tree of ``segmented``.

        Args:
            segmented: parts; category and part names are hints that may be missing.
            locked: joints that a person has fixed; they are returned unchanged.
            seed: the only source of randomness.
            progress: may raise :class:`~model.core.progress.Cancelled`.
        """
        ...


PREDICTORS = Registry[Predictor](
    "predictor",
    Predictor,
    "name and predict",
    {
        "hybrid": "model.prediction.arti4urdf.predictor:hybrid",
        "arti4urdf": "model.prediction.arti4urdf.predictor:network_alone",
        "geometric": "model.prediction.geometric.predictor:GeometricPredictor",
    },
    group="artiworld.predictors",
    parametrised={
        "hybrid": "model.prediction.arti4urdf.predictor:hybrid",
        "arti4urdf": "model.prediction.arti4urdf.predictor:network_alone",
        "learned": "model.prediction.arti4urdf.predictor:learned",
        "without": "model.prediction.ablation:WithoutMechanism",
        "qwen3": "model.prediction.arti4urdf.full_predictor:with_local_engine",
        "qwen3-vllm": "model.prediction.arti4urdf.full_predictor:with_vllm",
    },
)


def predictor_names() -> tuple[str, ...]:
    """Names that :func:`load_predictor` takes, built-ins first."""
    return PREDICTORS.names()


def load_predictor(name: str = DEFAULT) -> Predictor:
    """The predictor called ``name``.

    The address of a backend is a name too. ``qwen3:FOLDER`` is the paper-size model with the
    weights in that folder, ``hybrid:FOLDER`` the small one with weights of one's own, and
    ``learned:FOLDER`` adds what a workspace's accepted objects say.

    Raises:
        ConfigurationError: if there is none, naming those that are there, or where a plug-in
            can't be loaded or is no predictor.
    """
    if is_backend(name):
        from model.prediction.remote_backend import HttpPredictor  # only to ask a backend

        return HttpPredictor(name)
    return PREDICTORS.load(name)


def check_predictor(name: str) -> None:
    """Refuse a name that no predictor has, without loading one.

    Raises:
        ConfigurationError: naming those that are there.
    """
    if not is_backend(name):
        PREDICTORS.check(name)
