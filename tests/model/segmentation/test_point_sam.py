"""Point-SAM's adapter with random weights: it honours the protocol, and loads strictly."""

import numpy as np
import pytest

pytest.importorskip("torch", reason="PyTorch is not installed")

import torch
from safetensors.torch import save_file

from model.core.errors import InputFileError
from model.segmentation.adapters.point_sam import load_network
from model.segmentation.adapters.point_sam_network import PointSamConfig, PointSamNetwork
from model.segmentation.prompts import Click, Prompts
from model.segmentation.registry import load_segmenter

SMALL = PointSamConfig(
    width=64, depth=2, hidden=48, patch=24, embed=32, decoder_hidden=40, groups=64, group_size=8
)


def write_weights(path, change=lambda state: state) -> None:
    torch.manual_seed(3)
    save_file(change(PointSamNetwork(SMALL).state_dict()), path)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    path = tmp_path_factory.mktemp("weights") / "model.safetensors"
    write_weights(path)
    return path


def test_the_names_are_those_of_the_published_checkpoint():
    """A few of each module, as the published code names them."""
    names = set(PointSamNetwork(SMALL).state_dict())
    encoder = """patch_embed.patch_encoder.conv1.3.weight patch_proj.bias pos_embed.2.weight
        transformer.blocks.1.attn.k_proj.weight transformer.blocks.1.mlp.fc1_g.weight
        transformer.fc_norm.weight out_proj.weight"""
    prompts = """point_encoder.pe_layer.positional_encoding_gaussian_matrix
        point_encoder.point_embeddings.1.weight mask_encoder.patch_encoder.conv2.3.bias
        mask_encoder.no_mask_embed.weight"""
    decoder = """transformer.layers.1.cross_attn_image_to_token.out_proj.weight
        transformer.norm_final_attn.weight output_hypernetworks_mlps.3.layers.2.weight
        output_upscaling.3.weight iou_prediction_head.layers.2.bias"""
    assert {f"pc_encoder.{name}" for name in encoder.split()} | {*prompts.split()} <= names
    assert {f"mask_decoder.{name}" for name in decoder.split()} <= names
    assert "pc_encoder.transformer.blocks.0.attn.k_proj.bias" not in names


def test_prompts_are_honoured_and_undo_is_exact(weights, cloud_cabinet):
    session = load_segmenter(f"point-sam:{weights}").encode(cloud_cabinet.asset)
    centers = cloud_cabinet.asset.element_centers
    clicks = []
    for part, element, positive in ((1, 900, True), (2, 15_000, True), (1, 4000, False)):
        clicks.append(Click(centers[element], part, positive, element))
    answers = [session.segment(Prompts(tuple(clicks[:k]))).labels for k in range(4)]
    assert not answers[0].any()
    assert answers[2][900] == 1 and answers[2][15_000] == 2
    assert answers[3][4000] != 1
    for k in reversed(range(4)):
        again = session.segment(Prompts(tuple(clicks[:k]))).labels
        assert np.array_equal(again, answers[k])
    for mask in session.candidates(Prompts((clicks[0],)), 1):
        assert mask[900] and mask.shape == (len(centers),)


def test_image_parts_of_the_encoder_are_skipped(tmp_path):
    def with_image_parts(state):
        extra = {
            "pc_encoder.transformer.cls_token": torch.zeros(1, 1, 64),
            "pc_encoder.transformer.patch_embed.proj.weight": torch.zeros(64, 3, 14, 14),
            "pc_encoder.transformer.head.bias": torch.zeros(1000),
        }
        return {**state, **extra}

    path = tmp_path / "model.safetensors"
    write_weights(path, with_image_parts)
    load_network(path, "cpu")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda s: {k: v for k, v in s.items() if "iou_token" not in k}, "iou_token"),
        (lambda s: {**s, "surplus.weight": torch.zeros(2)}, "surplus"),
        (lambda s: {**s, "mask_decoder.mask_tokens.weight": torch.zeros(5, 32)}, "mask_tokens"),
        (lambda s: {k: v * torch.nan for k, v in s.items()}, "finite"),
        (lambda s: {"something.else": torch.zeros(1)}, "Point-SAM"),
    ],
)
def test_weights_that_do_not_fit_are_named(tmp_path, change, message):
    path = tmp_path / "model.safetensors"
    write_weights(path, change)
    with pytest.raises(InputFileError, match=message):
        load_network(path, "cpu")


def test_files_that_are_no_checkpoints_are_refused(tmp_path):
    path = tmp_path / "model.safetensors"
    with pytest.raises(InputFileError, match="no such file"):
        load_segmenter(f"point-sam:{path}")
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(InputFileError, match="safetensors"):
        load_network(path, "cpu")
    pickled = tmp_path / "model.pth"
    pickled.write_bytes(b"\x80\x04.")
    with pytest.raises(InputFileError, match="no checkpoint"):
        load_network(pickled, "cpu")
