"""Objects and weights for the tests of Arti4URDF."""

import pytest

pytest.importorskip("torch", reason="torch is not installed")

import torch

from model.prediction.arti4urdf.language_model import DecoderConfig
from model.prediction.arti4urdf.network import ArtiModel, ModelConfig
from model.prediction.arti4urdf.point_bert import PointBertConfig
from model.prediction.arti4urdf.vocabulary import SIZE


@pytest.fixture(scope="session")
def tiny_model() -> ArtiModel:
    """Random weights, a few thousand of them."""
    torch.manual_seed(0)
    sizes = {"width": 24, "depth": 1, "heads": 2, "encoder_width": 16, "point_width": 8}
    sizes |= {"groups": 8, "neighbours": 8, "points": 64, "drop_path": 0.0}
    kind = {"normalisation": "layer", "unit_neighbourhoods": True, "skip_near_origin": False}
    points = PointBertConfig(**sizes, **kind)
    config = ModelConfig(points, DecoderConfig(SIZE, 32, 48, 2, 2, 1, head_dim=16), 48)
    return ArtiModel(config).eval()
