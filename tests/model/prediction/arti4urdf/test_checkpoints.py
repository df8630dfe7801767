"""Weights on disk: what fits loads exactly, what doesn't says why."""

import argparse
import dataclasses
import json
import os
import pickle
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra network")
pytest.importorskip("safetensors", reason="needs the extra network")

from safetensors.torch import load_file, save_file  # noqa: E402

from model.core.errors import InputFileError  # noqa: E402
from model.core.files import strict_load  # noqa: E402
from model.prediction.arti4urdf.checkpoints import (  # noqa: E402  # noqa: E402
    ENCODER_PREFIX,
    from_config,
    load_checkpoint,
    load_point_bert,
    load_qwen3,
    save_checkpoint,
)
from model.prediction.arti4urdf.language_model import Decoder, DecoderConfig  # noqa: E402
from model.prediction.arti4urdf.point_bert import ULIP2, PointBert, group_points  # noqa: E402
from tests.model.prediction.arti4urdf.tiny_qwen3 import write_tiny_qwen3  # noqa: E402

SMALL = DecoderConfig(97, 64, 160, 2, 4, 2, head_dim=32)


# --- ULIP-2


@pytest.fixture(scope="module")
def encoder():
    torch.manual_seed(0)
    return PointBert(dataclasses.replace(ULIP2, depth=2)).eval()


def ulip2_file(path: Path, state, **more) -> Path:
    """A file as ULIP-2's training leaves it: weights among a lot else."""
    args = argparse.Namespace(model="ULIP_PointBERT", npoints=10_000)
    body = {"state_dict": state, "epoch": 250, "args": args, "best_acc1": np.float64(50.6), **more}
    torch.save(body, path)
    return path


def ulip2_state(encoder):
    state = {ENCODER_PREFIX + name: value for name, value in encoder.state_dict().items()}
    return {
        **state,
        "module.pc_projection": torch.zeros(768, 1280),
        "module.logit_scale": torch.ones(()),
    }


@torch.no_grad()
def test_ulip2_checkpoint_loads_exactly(tmp_path, encoder):
    loaded = load_point_bert(ulip2_file(tmp_path / "ulip2.pt", ulip2_state(encoder)))
    assert loaded.config == encoder.config
    cloud = torch.rand(1, 600, 6, generator=torch.Generator().manual_seed(0)) - 0.5
    groups = group_points(cloud, encoder.config)
    assert torch.equal(loaded(groups), encoder(groups))


def test_ulip2_differences_are_named(tmp_path, encoder):
    state = ulip2_state(encoder)
    del state[ENCODER_PREFIX + "blocks.blocks.1.attn.qkv.weight"]
    state[ENCODER_PREFIX + "reduce_dim.weight"] = torch.zeros(384, 128)
    state[ENCODER_PREFIX + "surprise"] = torch.zeros(1)
    with pytest.raises(InputFileError) as failure:
        load_point_bert(ulip2_file(tmp_path / "other.pt", state))
    message = str(failure.value)
    assert "missing blocks.blocks.1.attn.qkv.weight" in message
    assert "unknown surprise" in message
    assert "reduce_dim.weight [384, 128] instead of [384, 256]" in message


class Hostile:
    def __reduce__(self):
        return (os.mkdir, ("executed",))


FAR = "blocks.blocks.99999999.norm1.bias"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "no such file"),
        (b"", "damaged or no torch file"),
        (b"PK\x03\x04 half a file", "damaged or no torch file"),
        (pickle.dumps(["a list"]), "damaged or no torch file"),
        (pickle.dumps(Hostile()), "damaged or no torch file"),
        ({"state_dict": {}, "extra": Hostile()}, r"contains code \(posix\.mkdir\)"),
        ({"weights": 1}, "has no 'state_dict'"),
        ({"state_dict": {"module.visual.proj": torch.zeros(2)}}, "has no weights called"),
        ({"state_dict": [torch.zeros(2)]}, "has no 'state_dict'"),
        ({"state_dict": {f"{ENCODER_PREFIX}{FAR}": torch.zeros(384)}}, "missing"),
    ],
    ids=range(10),
)
@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_what_is_no_ulip2_checkpoint(tmp_path, monkeypatch, content, words):
    monkeypatch.chdir(tmp_path)
    path = tmp_path / "file.pt"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif content is not None:
        torch.save(content, path)
    with pytest.raises(InputFileError, match=words):
        load_point_bert(path)
    assert not (tmp_path / "executed").exists()


def test_half_a_ulip2_file(tmp_path, encoder):
    path = ulip2_file(tmp_path / "ulip2.pt", ulip2_state(encoder))
    path.write_bytes(path.read_bytes()[:1_000_000])
    with pytest.raises(InputFileError, match="damaged"):
        load_point_bert(path)


def test_numbers_that_are_not_finite(tmp_path, encoder):
    state = ulip2_state(encoder)
    name = ENCODER_PREFIX + "norm.bias"
    state[name] = state[name].clone()
    state[name][3] = float("nan")
    with pytest.raises(InputFileError, match=r"not finite in norm\.bias"):
        load_point_bert(ulip2_file(tmp_path / "nan.pt", state))


# --- Qwen3


@torch.no_grad()
@pytest.mark.parametrize("tied", [True, False])
@pytest.mark.parametrize("shard", ["5GB", "40KB"])
def test_qwen3_folder_loads_exactly(tmp_path, tied, shard):
    transformers = pytest.importorskip("transformers", reason="needs the extra network")
    folder = write_tiny_qwen3(tmp_path, tied=tied, shard=shard)
    assert (folder / "model.safetensors.index.json").exists() == (shard == "40KB")
    ours = load_qwen3(folder, dtype=torch.float32)
    theirs = transformers.Qwen3ForCausalLM.from_pretrained(folder, dtype=torch.float32).eval()
    ids = torch.tensor([ours.tokenizer.encode("a door turns").ids])
    answer = ours.decoder.logits(ours.decoder(ours.decoder.embed(ids)))
    torch.testing.assert_close(answer, theirs(ids).logits, atol=1e-5, rtol=0)


@pytest.fixture
def qwen(tmp_path):
    pytest.importorskip("transformers", reason="needs the extra network")
    return write_tiny_qwen3(tmp_path / "qwen")


def test_shared_matrix_may_be_written_twice(qwen):
    path = qwen / "model.safetensors"
    state = load_file(path)
    state["lm_head.weight"] = state["model.embed_tokens.weight"].clone()
    save_file(state, path)
    assert load_qwen3(qwen).decoder.lm_head is None
    state["lm_head.weight"] += 1
    save_file(state, path)
    with pytest.raises(InputFileError, match="their weights differ"):
        load_qwen3(qwen)


def _edit(path: Path, **values: object) -> None:
    path.write_text(json.dumps({**json.loads(path.read_text()), **values}))


def _drop_a_weight(folder: Path) -> None:
    state = load_file(folder / "model.safetensors")
    del state["model.layers.1.self_attn.q_norm.weight"]
    save_file(state, folder / "model.safetensors")


def _halve(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def _point_outside(folder: Path) -> None:
    index = {"weight_map": {"model.norm.weight": "../../secret.safetensors"}}
    (folder / "model.safetensors.index.json").write_text(json.dumps(index))


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: (f / "config.json").unlink(), "can't be read"),
        (lambda f: (f / "config.json").write_text("{"), "is not JSON"),
        (lambda f: _edit(f / "config.json", model_type="llama"), "not qwen3"),
        (lambda f: _edit(f / "config.json", attention_bias=True), "attention_bias True is not"),
        (lambda f: _edit(f / "config.json", rope_parameters={"rope_type": "yarn"}), "yarn"),
        (lambda f: _edit(f / "config.json", hidden_size="wide"), "wide"),
        (lambda f: _edit(f / "config.json", num_key_value_heads=3), "3 key heads don't divide"),
        (lambda f: _edit(f / "config.json", hidden_size=32), "of another shape"),
        (lambda f: _edit(f / "config.json", num_hidden_layers=3), "missing model.layers.2"),
        (_drop_a_weight, "missing model.layers.1.self_attn.q_norm.weight"),
        (lambda f: (f / "model.safetensors").unlink(), "no such file"),
        (lambda f: _halve(f / "model.safetensors"), "damaged"),
        (lambda f: (f / "tokenizer.json").unlink(), "no such file"),
        (lambda f: (f / "tokenizer.json").write_text("[]"), "is no tokenizer"),
        (_point_outside, "which is no file of this folder"),
    ],
)
def test_qwen3_folders_that_do_not_fit(qwen, damage, words):
    damage(qwen)
    with pytest.raises(InputFileError, match=words):
        load_qwen3(qwen)


def test_no_qwen3_folder(tmp_path):
    with pytest.raises(InputFileError, match="no such folder"):
        load_qwen3(tmp_path / "absent")


# --- our own folders


def test_own_checkpoint_comes_back(tmp_path):
    decoder = Decoder(SMALL)
    config = {"decoder": dataclasses.asdict(SMALL), "trained_on": "nothing"}
    save_checkpoint(tmp_path / "made", config, decoder.state_dict())
    read = load_checkpoint(tmp_path / "made")
    assert read.config == config
    twin = Decoder(from_config(DecoderConfig, read.config["decoder"], read.folder))
    strict_load(twin, read.state, read.folder)
    for name, value in decoder.state_dict().items():
        kept = value if value.ndim < 2 else value.bfloat16().float()
        assert torch.equal(twin.state_dict()[name], kept), name
    assert sorted(p.name for p in (tmp_path / "made").iterdir()) == [
        "config.json",
        "weights.safetensors",
    ]


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda f: _edit(f / "config.json", format=2), "format 2; this version reads format 1"),
        (lambda f: (f / "config.json").unlink(), "can't be read"),
        (lambda f: (f / "config.json").write_text("7"), "is not a JSON object"),
        (lambda f: (f / "weights.safetensors").unlink(), "no such file"),
        (lambda f: _halve(f / "weights.safetensors"), "damaged"),
    ],
)
def test_own_checkpoints_that_are_damaged(tmp_path, damage, words):
    save_checkpoint(tmp_path, {}, {"weight": torch.zeros(40, 40)})
    damage(tmp_path)
    with pytest.raises(InputFileError, match=words):
        load_checkpoint(tmp_path)


@pytest.mark.parametrize(
    ("values", "words"),
    [
        (None, "DecoderConfig: expected an object"),
        ({"vocab_size": 1}, "hidden_size' is missing"),
        ({**dataclasses.asdict(SMALL), "wings": 2}, "unknown field 'wings'"),
        ({**dataclasses.asdict(SMALL), "kv_heads": 3}, "3 key heads"),
    ],
)
def test_configurations_that_do_not_fit(tmp_path, values, words):
    with pytest.raises(InputFileError, match=words):
        from_config(DecoderConfig, values, tmp_path)
