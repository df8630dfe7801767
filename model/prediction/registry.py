"""All predictors in one table."""

from __future__ import annotations

from model.core.packages import Registry
from model.prediction import DEFAULT
from model.prediction.protocol import Predictor
from model.prediction.remote import is_backend

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
        from model.prediction.remote.http_predictor import HttpPredictor  # only to ask a backend

        return HttpPredictor(name)
    return PREDICTORS.load(name)


def check_predictor(name: str) -> None:
    """Refuse a name that no predictor has, without loading one.

    Raises:
        ConfigurationError: naming those that are there.
    """
    if not is_backend(name):
        PREDICTORS.check(name)
