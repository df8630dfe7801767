"""The paper-size model's training: what is drawn, slices, weights that predict, clear mistakes."""

from __future__ import annotations

import dataclasses
import json
import sys
from pathlib import Path

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="needs the extra network")
for _name in ("transformers", "accelerate"):
    pytest.importorskip(_name, reason="needs the extra train")

from app.cli.main import main  # noqa: E402
from model.core.errors import ConfigurationError, InputFileError  # noqa: E402
from model.data.procedural.generate import GenerateSettings, generate  # noqa: E402
from model.data.registry import recognised, training_ids  # noqa: E402
from model.prediction.arti4urdf.answer import JSON_END, parse_answer, write_answer  # noqa: E402
from model.prediction.arti4urdf.checkpoints import ENCODER_PREFIX, load_tokenizer  # noqa: E402
from model.prediction.arti4urdf.full_model import SPECIAL_TOKENS  # noqa: E402
from model.prediction.arti4urdf.point_bert import ULIP2, PointBert  # noqa: E402
from model.prediction.arti4urdf.text_script import AnswerScript  # noqa: E402
from model.prediction.registry import load_predictor  # noqa: E402
from model.training.arti4urdf.config import (  # noqa: E402
    FullConfig,
    check_size,
    full_presets,
    require_extras,
    with_settings,
)
from model.training.arti4urdf.full_data import Draws, ObjectSet, positions, varied  # noqa: E402
from model.training.arti4urdf.full_trainer import LEFT_OUT, Sources, train_full  # noqa: E402
from model.training.arti4urdf.samples import training_families, write_dataset  # noqa: E402
from tests.app.run_cli import artiworld, assert_users_mistake  # noqa: E402
from tests.model.prediction.arti4urdf.tiny_qwen3 import write_tiny_qwen3  # noqa: E402

SMALL = FullConfig(
    samples=6,
    steps=4,
    batch=2,
    learning_rate=3e-3,
    warmup=1,
    longest=6000,
    points=64,
    groups=8,
    neighbours=4,
    every=2,
    validation=1,
)


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> tuple[Path, Path]:
    """A ULIP-2 file of one block and a tiny Qwen3 folder."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    encoder = PointBert(dataclasses.replace(ULIP2, depth=1))
    state = {ENCODER_PREFIX + name: value for name, value in encoder.state_dict().items()}
    torch.save({"state_dict": state}, folder / "ulip2.pt")
    return folder / "ulip2.pt", write_tiny_qwen3(folder / "qwen3")


@pytest.fixture(scope="module")
def tokenizer(weights):
    made = load_tokenizer(weights[1])
    made.add_special_tokens(list(SPECIAL_TOKENS))
    return made


@pytest.fixture(scope="module")
def partnet(tmp_path_factory) -> Path:
    """Folders of PartNet-Mobility's form: a laptop, an oven (held out), and one that is broken."""
    root = tmp_path_factory.mktemp("partnet")
    generate(GenerateSettings(root, ("Laptop", "Oven"), seed=3))
    (root / "broken").mkdir()
    (root / "broken" / "mobility.urdf").write_text("<robot")
    return root


def sources(weights, **objects) -> Sources:
    made = ObjectSet(SMALL.samples, 1, training_families(), **objects)
    return Sources(*weights, made, ObjectSet(1, 900, training_families()))


def words(weights, out: Path, *more: object) -> list[object]:
    """The command line for the run that :data:`SMALL` describes."""
    settings = dataclasses.asdict(SMALL)
    names = set(settings) - {"size", "samples", "steps", "seed", "held_out", "test_share"}
    said = [w for n in sorted(names) for w in ("--set", f"{n}={json.dumps(settings[n])}")]
    return [
        "train", "--preset", "qwen3", "--point-encoder", weights[0], "--language-model", weights[1],
        "--out", out, "--samples", SMALL.samples, "--steps", SMALL.steps, "--jobs", 1, *said, *more,
    ]  # fmt: skip


def test_slices_from_the_command_line_equal_one_run_and_predict(weights, tmp_path):
    run, cache, made = (tmp_path / name for name in ("run", "cache", "weights"))
    assert train_full(SMALL, sources(weights), run, seconds=0).step == 1
    done = artiworld(*words(weights, run, "--cache", cache, "--minutes", 9, "--weights", made))
    assert done.returncode == 0, done.stderr
    assert "step 4 of 4" in done.stdout
    assert list(cache.glob("*.npz")), "objects are kept"
    entries = [json.loads(line) for line in (run / "log.jsonl").read_text().splitlines()]
    assert [e["step"] for e in entries] == [1, 2, 4]
    assert entries[-1]["loss"] < entries[0]["loss"] - 0.3
    assert all(np.isfinite(e["valid loss"]) for e in entries)
    assert list((run / "tensorboard").glob("events*"))
    said = json.loads((run / "config.json").read_text())
    assert said["steps"] == 4 and said["seeds"] == {"objects": 1, "validation": 900}
    assert [p.name for p in run.glob("state-*")] == ["state-00000004"], "older states are gone"

    whole = tmp_path / "whole"
    finished = train_full(SMALL, sources(weights), whole, weights=tmp_path / "again")
    assert finished.step == finished.steps == 4
    for name in ("language_model/model.safetensors", "geometry/weights.safetensors"):
        a, b = (_tensors(folder / name) for folder in (made, tmp_path / "again"))
        assert a.keys() == b.keys()
        for key, value in a.items():
            assert torch.equal(value, b[key]), key
    before = _tensors(weights[1] / "model.safetensors")["model.layers.0.mlp.up_proj.weight"]
    after = _tensors(made / "language_model/model.safetensors")
    assert not torch.allclose(after["model.layers.0.mlp.up_proj.weight"].float(), before, atol=1e-3)

    truth = sources(weights).objects.load(0)
    answer = load_predictor(f"qwen3:{made}").predict(truth.segmented())
    assert answer.raw_text and (answer.tree is not None or answer.problems)


def _tensors(path: Path) -> dict[str, torch.Tensor]:
    from safetensors.torch import load_file

    return load_file(path)


def test_lora_trains_little_and_writes_a_whole_model(weights, tmp_path):
    pytest.importorskip("peft", reason="needs the extra train")
    config = dataclasses.replace(SMALL, lora_rank=4, steps=2, every=1, validation=0)
    lean = dataclasses.replace(sources(weights), held=ObjectSet(0, 900, training_families()))
    train_full(config, lean, tmp_path / "run", seconds=0)
    state = torch.load(tmp_path / "run/state-00000001/pytorch_model.bin", weights_only=True)
    assert any("lora" in name for name in state)
    assert not any("base_layer.weight" in name for name in state), "what is frozen isn't kept"
    assert train_full(config, lean, tmp_path / "run", weights=tmp_path / "w").step == 2
    load_predictor(f"qwen3:{tmp_path / 'w'}")


def test_an_object_and_its_answer_mean_the_same_whatever_the_order(tokenizer):
    objects = ObjectSet(8, 5, training_families())
    draws = Draws(objects, dataclasses.replace(SMALL, longest=50_000), tokenizer, 100)
    orders = set()
    for position in range(8):
        drawn = draws[position]
        assert drawn.example is not None and drawn.left_out == ()
        tree, problems = parse_answer(drawn.example.answer)
        assert tree is not None and problems == ()
        again = draws[position].example
        assert again is not None and again.prompt == drawn.example.prompt
        assert torch.equal(again.parts, drawn.example.parts)
        truth = objects.load(position).object
        for seed in range(3):
            segmented, said = varied(truth, SMALL, np.random.default_rng(seed))
            assert [p.link for p in segmented.parts] == [
                f"link_{i}" for i in range(len(truth.parts))
            ]
            orders.add((position, tuple(p.bounds.tobytes() for p in segmented.parts)))
            for part in segmented.parts:
                same = (p for p in truth.parts if p.mesh is part.mesh and p.cloud is part.cloud)
                assert motions(said, part.link) == motions(truth.tree, next(same).link)
            assert_writable(said, segmented)
    assert len(orders) > 12, "parts come in many orders"
    prompts = {drawn.example.prompt for drawn in map(draws.__getitem__, range(16))}
    assert len(prompts) > 12, "the second epoch draws other variants"


def motions(tree, link: str) -> list[tuple[object, ...]]:
    """Every joint from the root to ``link``, without names."""
    out: list[tuple[object, ...]] = []
    while link in tree.joint_of:
        joint = tree.joint_of[link]
        out.append((joint.type, joint.axis, joint.origin, joint.lower, joint.upper))
        link = joint.parent
    return sorted(out, key=str)  # the two of a screw may change places


def assert_writable(tree, segmented) -> None:
    """Constrained decoding can write the answer's tree, word for word."""
    target, text = write_answer(tree, segmented), ""
    steps = AnswerScript(segmented).steps()
    step = next(steps)
    while JSON_END not in text:
        if isinstance(step, str):
            text, step = text + step, steps.send("")
        else:
            rest = target[len(text) :]
            chosen = next(t for t in step.texts if rest.startswith(t))
            text, step = text + chosen, steps.send(chosen)
    assert target.startswith(text)


@pytest.mark.parametrize("processes", [1, 2, 4])
def test_processes_and_slices_share_one_order(processes):
    whole = positions(4, range(6), 0, 1)
    assert whole == list(range(24))
    shares = [
        positions(4, range(2), k, processes) + positions(4, range(2, 6), k, processes)
        for k in range(processes)
    ]
    turns = 4 // processes
    for step in range(6):
        here = [p for share in shares for p in share[step * turns : (step + 1) * turns]]
        assert sorted(here) == whole[4 * step : 4 * step + 4]


def test_names_are_hidden_in_some_samples_only():
    truth = ObjectSet(1, 5, ("Laptop",)).load(0).object
    found = [varied(truth, SMALL, np.random.default_rng(seed))[0].category for seed in range(40)]
    assert 8 < found.count(None) < 32
    assert set(found) == {None, "Laptop"}


def test_useless_objects_are_passed_over_and_counted(weights, partnet, tokenizer, tmp_path):
    dataset = recognised(partnet)
    ids = training_ids(dataset)
    assert ids == ("Laptop_3_0", "broken"), "the oven is held out"
    assert len(training_ids(dataset, held_out=True)) == 3
    objects = ObjectSet(1, 1, ("Laptop",), tuple((dataset, i) for i in ids))
    draws = Draws(objects, SMALL, tokenizer, 12)
    seen = [draws[p] for p in range(3)]
    assert all(d.example is not None for d in seen)
    (left,) = [x for d in seen for x in d.left_out[:1]]
    assert left[0].endswith("broken") and "mobility.urdf" in left[1]

    short = dataclasses.replace(SMALL, longest=200)
    plan = dataclasses.replace(sources(weights), objects=objects)
    with pytest.raises(ConfigurationError, match=r"objects in a row .* more than 200"):
        train_full(short, plan, tmp_path / "run")
    assert "too long" in (tmp_path / "run" / LEFT_OUT).read_text()


def test_a_ball_joint_is_passed_over(tokenizer, tmp_path):
    write_physxnet_box(tmp_path, lid=[[1], "0", [0, 0, 0, 0, 0.27, 0], "D"])
    objects = ObjectSet(0, 0, (), ((recognised(tmp_path), "box"),))
    drawn = Draws(objects, SMALL, tokenizer, 1)[0]
    assert drawn.example is None
    assert "compound motion" in drawn.left_out[-1][1]


def test_a_damaged_cache_is_made_again(tmp_path):
    fresh = ObjectSet(1, 5, ("Laptop",)).load(0)
    kept = ObjectSet(1, 5, ("Laptop",), cache=tmp_path)
    kept.load(0)
    (file,) = tmp_path.glob("*.npz")
    for damage in (None, b"", file.read_bytes()[:300]):
        if damage is not None:
            file.write_bytes(damage)
        again = kept.load(0)
        assert again.object.tree.joints == fresh.object.tree.joints
        for a, b in zip(again.object.parts, fresh.object.parts, strict=True):
            assert (a.link, a.name) == (b.link, b.name)
            np.testing.assert_allclose(a.bounds, b.bounds)


def test_physxnet_and_partnet_folders_feed_the_small_model(partnet, tmp_path):
    physxnet = tmp_path / "physxnet"
    write_physxnet_box(physxnet)
    assert recognised(physxnet).name == "physxnet"
    count, bad = write_dataset(physxnet, tmp_path / "shards")
    assert (count, bad) == (2, [])
    count, bad = write_dataset(partnet, tmp_path / "shards")
    assert count == 2 and len(bad) == 1 and "broken" in bad[0]
    assert len(list((tmp_path / "shards").glob("*.npz"))) == 2
    with pytest.raises(InputFileError, match=r"PartNet-Mobility object .* none of PhysXNet"):
        recognised(tmp_path / "shards")


def write_physxnet_box(root: Path, lid: list[object] | None = None) -> None:
    """A box with a lid in PhysXNet's form; ``lid`` is how it moves."""
    import trimesh

    (root / "finaljson").mkdir(parents=True)
    meshes = root / "partseg" / "box" / "objs"
    meshes.mkdir(parents=True)
    for label, size, up in ((0, (1, 0.5, 1), 0.0), (1, (1, 0.1, 1), 0.32)):
        made = trimesh.creation.box(size)
        made.apply_translation((0, up, 0))
        made.export(meshes / f"{label}.obj")
    lid = lid or [[1], "0", [1, 0, 0, 0, 0.27, -0.5, 0, 0.5], "C"]
    said = {
        "object_name": "box", "category": "Box", "dimension": "40*20*40",
        "parts": [{"label": 0, "name": "body"}, {"label": 1, "name": "lid"}],
        "group_info": {"0": [0], "1": lid},
    }  # fmt: skip
    (root / "finaljson" / "box.json").write_text(json.dumps(said))


def test_mistakes_are_named(weights, tmp_path, monkeypatch):
    assert set(full_presets()) == {"qwen3-0.6b", "qwen3-1.7b", "qwen3-4b", "paper", "qwen3"}
    with pytest.raises(InputFileError, match=r"unlike Qwen3-8B.*--preset qwen3 for this one"):
        check_size(full_presets()["paper"], weights[1])
    config = json.loads((weights[1] / "config.json").read_text())
    config |= {
        "hidden_size": 1024, "intermediate_size": 3072, "num_hidden_layers": 28,
        "num_attention_heads": 16, "num_key_value_heads": 8, "head_dim": 128,
    }  # fmt: skip
    (tmp_path / "config.json").write_text(json.dumps(config))
    with pytest.raises(InputFileError, match=r"--preset qwen3-0\.6b for this one"):
        check_size(full_presets()["paper"], tmp_path)
    check_size(full_presets()["qwen3-0.6b"], tmp_path)
    for setting, words_ in (
        ("epochs", "write NAME=VALUE"), ("speed=1", "names are"), ("epochs=two", "Expecting"),
        ("epochs=2.5", "a whole number"), ("batch=0", "1 or more"), ("nameless=2", "0..1"),
    ):  # fmt: skip
        with pytest.raises(ConfigurationError, match=words_):
            with_settings(SMALL, [setting])
    monkeypatch.setitem(sys.modules, "accelerate", None)
    with pytest.raises(ConfigurationError, match=r"accelerate: .*pip install 'artiworld\[train\]'"):
        require_extras(SMALL)


def test_a_state_that_is_damaged_and_another_run_in_the_folder(weights, tmp_path):
    one = dataclasses.replace(SMALL, validation=0)
    plan = dataclasses.replace(sources(weights), held=ObjectSet(0, 900, training_families()))
    train_full(one, plan, tmp_path, seconds=0)
    (tmp_path / "state-00000001" / "optimizer.bin").write_bytes(b"no")
    with pytest.raises(ConfigurationError, match=r"can't be read .*delete that file"):
        train_full(one, plan, tmp_path)
    (tmp_path / "config.json").write_text('{"batch": 3}')
    with pytest.raises(ConfigurationError, match=r"another run \(batch, "):
        train_full(SMALL, sources(weights), tmp_path)


def test_the_command_line_names_mistakes(weights, tmp_path, capsys):
    out = ["--out", str(tmp_path)]
    for more, said in (
        (["--preset", "paper"], "--language-model, a folder of Qwen3, and --point-encoder"),
        (["--preset", "nano", "--lora"], "belong to the paper-size model"),
        (["--preset", "qwen4"], "qwen3-0.6b, qwen3-1.7b, qwen3-4b, paper, qwen3"),
        (["--preset", "paper", "--test-share", "2"], "--test-share"),
    ):
        assert main(["train", *out, *more]) == 2
        assert said in capsys.readouterr().err
    done = artiworld(*words((weights[1] / "config.json", weights[1]), tmp_path))
    assert_users_mistake(done, "config.json", "torch file")
