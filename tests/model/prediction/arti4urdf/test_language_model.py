"""The decoder against transformers' Qwen3 on random weights, and its cache."""

from dataclasses import replace

import pytest

torch = pytest.importorskip("torch", reason="needs the extra network")

from model.prediction.arti4urdf.language_model import QWEN3, Decoder, DecoderConfig  # noqa: E402

SMALL = DecoderConfig(97, 64, 160, 3, 4, 2, head_dim=32)


def decoder(config: DecoderConfig = SMALL, seed: int = 0):
    torch.manual_seed(seed)
    made = Decoder(config)
    # Norms of ones would hide a norm that is left out.
    for name, parameter in made.named_parameters():
        if "norm" in name:
            torch.nn.init.uniform_(parameter, 0.5, 1.5)
    return made.eval()


def published(config: DecoderConfig):
    """Transformers' model of the same sizes."""
    transformers = pytest.importorskip("transformers", reason="needs the extra network")
    same = "vocab_size hidden_size intermediate_size head_dim"
    sizes = {name: getattr(config, name) for name in same.split()}
    sizes |= {"num_hidden_layers": config.layers, "num_attention_heads": config.heads}
    sizes |= {"num_key_value_heads": config.kv_heads, "rms_norm_eps": config.rms_eps}
    sizes |= {"rope_parameters": {"rope_type": "default", "rope_theta": config.rope_theta}}
    made = transformers.Qwen3Config(tie_word_embeddings=config.tied, **sizes)
    return transformers.Qwen3ForCausalLM(made).eval()


@pytest.fixture
def ids():
    return torch.randint(0, SMALL.vocab_size, (2, 19), generator=torch.Generator().manual_seed(1))


def close(a, b, tolerance: float = 1e-5) -> None:
    torch.testing.assert_close(a, b, atol=tolerance, rtol=0)


@pytest.mark.parametrize("tied", [True, False])
def test_same_logits_as_transformers(ids, tied):
    config = replace(SMALL, tied=tied)
    ours, theirs = decoder(config), published(config)
    missing, unexpected = theirs.load_state_dict(ours.state_dict(), strict=False)
    assert not unexpected
    assert missing == (["lm_head.weight"] if tied else [])
    theirs.tie_weights()
    with torch.no_grad():
        embeds = ours.embed(ids)
        close(ours.logits(ours(embeds)), theirs(inputs_embeds=embeds).logits)
        # Transformers' own padding: at the left, where the mask alone can hide it.
        mask = torch.ones_like(ids)
        mask[1, :7] = 0
        padded = theirs(input_ids=ids, attention_mask=mask).logits[1, 7:]
        close(ours.logits(ours(embeds[1:, 7:]))[0], padded)


def test_state_dict_has_the_published_shapes():
    theirs = published(SMALL).state_dict()
    ours = decoder().state_dict()
    assert {name: value.shape for name, value in theirs.items() if name != "lm_head.weight"} == {
        name: value.shape for name, value in ours.items()
    }


@pytest.mark.parametrize("size", QWEN3)
def test_presets_are_the_published_sizes(size):
    config = QWEN3[size]
    with torch.device("meta"):
        count = sum(parameter.numel() for parameter in Decoder(config).parameters())
    billions = {"0.6b": 0.596, "1.7b": 1.721, "4b": 4.022, "8b": 8.191}[size]
    assert round(count / 1e9, 3) == billions


@torch.no_grad()
def test_appended_spans_give_the_same_as_one_pass(ids):
    ours = decoder()
    whole = ours(ours.embed(ids))
    cache = ours.new_cache(2, capacity=3)
    parts = [ours(ours.embed(part), cache=cache) for part in ids.split([5, 1, 1, 7, 5], dim=1)]
    close(torch.cat(parts, 1), whole)
    cache.truncate(4)
    again = [ours(ours.embed(part), cache=cache) for part in ids[:, 4:].split([9, 6], dim=1)]
    close(torch.cat(again, 1), whole[:, 4:])
    with pytest.raises(ValueError, match="19 tokens to 20"):
        cache.truncate(20)


@torch.no_grad()
def test_cached_spans_as_transformers_has_them(ids):
    ours, theirs = decoder(), published(SMALL)
    theirs.load_state_dict(ours.state_dict(), strict=False)
    theirs.tie_weights()
    cache, state = ours.new_cache(2), None
    for part in ids.split([8, 1, 4, 6], dim=1):
        answer = theirs(input_ids=part, past_key_values=state, use_cache=True)
        state = answer.past_key_values
        close(ours.logits(ours(ours.embed(part), cache=cache)), answer.logits)


def test_every_parameter_learns(ids):
    ours = decoder(replace(SMALL, tied=False)).train()
    with torch.inference_mode():  # must leave nothing behind that training can't use
        ours(ours.embed(ids))
    hidden = ours(ours.embed(ids))
    ours.logits(hidden[:, :-1]).log_softmax(-1).gather(2, ids[:, 1:, None]).mean().backward()
    for parameter in ours.parameters():
        assert parameter.grad is not None
        assert parameter.grad.abs().sum() > 0


@torch.no_grad()
def test_bfloat16_keeps_exact_angles(ids):
    ours = decoder()
    exact = ours.logits(ours(ours.embed(ids)))
    rounded = ours.bfloat16()
    cache = rounded.new_cache(2)
    hidden = [rounded(rounded.embed(part), cache=cache) for part in ids.split(7, dim=1)]
    close(rounded.logits(torch.cat(hidden, 1)).float(), exact, 0.05)
