"""The paper-size model on tiny random weights: loading, a training step, saving, generation."""

import dataclasses
import math
from pathlib import Path

import pytest

torch = pytest.importorskip("torch", reason="needs the extra network")
pytest.importorskip("transformers", reason="needs the extra network")

from model.core.errors import ConfigurationError, InputFileError  # noqa: E402
from model.prediction.arti4urdf.checkpoints import ENCODER_PREFIX, load_qwen3  # noqa: E402
from model.prediction.arti4urdf.full_model import (  # noqa: E402
    SPECIAL_TOKENS,
    Example,
    FullModel,
    LoraSettings,
    load_full_model,
    make_full_model,
)
from model.prediction.arti4urdf.point_bert import ULIP2, PointBert  # noqa: E402
from tests.model.prediction.arti4urdf.tiny_qwen3 import write_tiny_qwen3  # noqa: E402

ANSWER = '<json_start>{"part": "link_0"}<json_end><urdf_start><robot/><urdf_end>'


@pytest.fixture(scope="module")
def weights(tmp_path_factory) -> tuple[Path, Path]:
    """A ULIP-2 file of one block and a Qwen3 folder with an untied output."""
    folder = tmp_path_factory.mktemp("weights")
    torch.manual_seed(0)
    encoder = PointBert(dataclasses.replace(ULIP2, depth=1))
    state = {ENCODER_PREFIX + name: value for name, value in encoder.state_dict().items()}
    torch.save({"state_dict": state}, folder / "ulip2.pt")
    return folder / "ulip2.pt", write_tiny_qwen3(folder / "qwen3", tied=False)


def make(weights, **options) -> FullModel:
    torch.manual_seed(1)
    model = make_full_model(*weights, dtype=torch.float32, **options)
    # As few groups as a quick test allows; no weight depends on their number.
    model.encoder.config = dataclasses.replace(model.encoder.config, groups=8, neighbours=4)
    return model


def example(parts: int, answer: str = ANSWER, seed: int = 0) -> Example:
    generator = torch.Generator().manual_seed(seed)
    slots = "<p>" * parts
    return Example(
        f"a box <g_start><g><g_end> <p_start>{slots}<p_end>",
        torch.rand(40, 6, generator=generator) - 0.5,
        torch.rand(parts, 40, 6, generator=generator) - 0.5,
        answer,
    )


def test_new_words_are_single_tokens_at_the_mean(weights):
    model = make(weights)
    base = load_qwen3(weights[1], dtype=torch.float32)
    known = base.tokenizer.get_vocab_size()
    for table, old in (
        (model.language_model.get_input_embeddings(), base.decoder.model.embed_tokens),
        (model.language_model.get_output_embeddings(), base.decoder.lm_head),
    ):
        assert old is not None
        for token in SPECIAL_TOKENS:
            ids = model.tokenizer.encode(token, add_special_tokens=False).ids
            assert len(ids) == 1
            torch.testing.assert_close(table.weight[ids[0]], old.weight[:known].mean(0))


def test_clouds_stand_where_their_words_stood(weights):
    model = make(weights).eval()
    one, two = example(1), example(3, seed=1)
    with torch.no_grad():
        embeds, mask, labels = model.embed([one, two])
        parts = model.part_adapter(model.geometry(two.parts))
        whole = model.global_adapter(model.geometry(two.cloud[None]))
    ids = model.tokenizer.encode(two.prompt, add_special_tokens=False).ids
    slot = model.tokenizer.token_to_id("<p>")
    at = [i for i, t in enumerate(ids) if t == slot]
    torch.testing.assert_close(embeds[1, at], parts)
    where = ids.index(model.tokenizer.token_to_id("<g>"))
    torch.testing.assert_close(embeds[1, where], whole[0])
    assert not torch.allclose(parts[0], parts[1], atol=1e-3)
    answer = model.tokenizer.encode(ANSWER, add_special_tokens=False).ids
    assert labels[1][labels[1] >= 0].tolist() == [*answer, model.end]
    assert int(mask[0].sum()) == embeds.shape[1] - 2
    # Padding changes nothing.
    with torch.no_grad():
        both = model([one, two])
        alone = torch.stack([model([one]), model([two])])
    torch.testing.assert_close(both, alone.mean(), atol=1e-5, rtol=0)


@pytest.mark.parametrize("lora", [None, LoraSettings(rank=4, dropout=0.0)])
def test_training_lowers_the_loss_and_saving_keeps_it(weights, tmp_path, lora):
    if lora is not None:
        pytest.importorskip("peft", reason="needs the extra train")
    model = make(weights, lora=lora).train()
    model.use_gradient_checkpointing()
    assert not model.encoder.training
    encoder_before = [p.clone() for p in model.encoder.state_dict().values()]
    optimiser = torch.optim.AdamW(model.trained_parameters(), lr=3e-3)
    losses = []
    for _ in range(6):
        optimiser.zero_grad()
        loss = model([example(2)])
        loss.backward()
        silent = [n for n, p in model.named_parameters() if p.requires_grad and p.grad is None]
        assert silent == []
        optimiser.step()
        losses.append(loss.item())
    assert losses[-1] < losses[0] - 0.5
    for before, after in zip(encoder_before, model.encoder.state_dict().values(), strict=True):
        assert torch.equal(before, after)
    model.eval().save(tmp_path)
    again = load_full_model(tmp_path, dtype=torch.float32)
    assert again.encoder.config == model.encoder.config
    with torch.no_grad():
        expected, found = model([example(2)]).item(), again([example(2)]).item()
    assert math.isclose(expected, found, rel_tol=1e-4)
    # Other programs read the language model alone, and so does our own decoder.
    assert load_qwen3(tmp_path / "language_model").tokenizer.token_to_id("<p_end>") is not None


@torch.no_grad()
def test_our_decoder_continues_a_prompt_as_transformers_does(weights, tmp_path):
    model = make(weights).eval()
    embeds = model.prompt_embeddings(example(2))
    theirs = model.language_model.generate(
        inputs_embeds=embeds[None], max_new_tokens=12, do_sample=False, eos_token_id=-1
    )[0]
    model.save(tmp_path)
    ours = load_qwen3(tmp_path / "language_model", dtype=torch.float32).decoder
    cache, said = ours.new_cache(1), []
    hidden = ours(embeds[None], cache=cache)
    for _ in range(12):
        said.append(int(ours.logits(hidden[0, -1]).argmax()))
        hidden = ours(ours.embed(torch.tensor([[said[-1]]])), cache=cache)
    assert said == theirs.tolist()


def test_prompts_and_clouds_must_agree(weights):
    model = make(weights)
    with pytest.raises(ConfigurationError, match="2 <p> for 3 clouds"):
        model([dataclasses.replace(example(3), prompt=example(2).prompt)])
    with pytest.raises(ConfigurationError, match="must not hold"):
        model([dataclasses.replace(example(1), answer="<p>")])


def test_weights_that_are_not_there(weights, tmp_path):
    with pytest.raises(InputFileError, match="no such file"):
        make_full_model(tmp_path / "ulip2.pt", weights[1])
    with pytest.raises(InputFileError, match="no such folder"):
        make_full_model(weights[0], tmp_path / "qwen3")
    with pytest.raises(InputFileError, match="can't be read"):
        load_full_model(tmp_path)
