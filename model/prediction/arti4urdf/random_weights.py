"""Random weights of the published sizes in the published formats.

They show what a machine can run before gigabytes are downloaded.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import torch
from tokenizers import Regex, Tokenizer, decoders, models, pre_tokenizers, trainers

from model.prediction.arti4urdf.language_model import DecoderConfig
from model.prediction.arti4urdf.point_bert import ULIP2, PointBert, PointBertConfig
from model.prediction.arti4urdf.published_weights import ENCODER_PREFIX, TOKENIZER_FILE

_WORDS = r" ?[A-Za-z]+|\d| ?[^\sA-Za-z\d]+|\s*[\r\n]+|\s+"
"""Approximately Qwen's pre-tokeniser: words, single digits, runs of signs."""
_SPECIAL = ("<|endoftext|>", "<|im_start|>", "<|im_end|>")
_TOKENS = 4000


def write_random_qwen3(
    folder: Path, size: DecoderConfig, texts: Iterable[str], *, device: str = "cpu", seed: int = 0
) -> Path:
    """A Qwen3 folder that :func:`~model.prediction.arti4urdf.published_weights.load_qwen3` reads.

    Args:
        folder: is created. size: of the language model and its vocabulary.
        texts: from which the tokenizer learns byte pairs, so that similar texts have about as many
            tokens as with the published one.
        device: on which the weights are drawn. seed: random seed.

    Returns:
        ``folder``.
    """
    import transformers

    folder.mkdir(parents=True, exist_ok=True)
    tokenizer = _tokenizer(texts, min(_TOKENS, size.vocab_size))
    tokenizer.save(str(folder / TOKENIZER_FILE))
    torch.manual_seed(seed)
    config = transformers.Qwen3Config(
        vocab_size=size.vocab_size,
        hidden_size=size.hidden_size,
        intermediate_size=size.intermediate_size,
        num_hidden_layers=size.layers,
        num_attention_heads=size.heads,
        num_key_value_heads=size.kv_heads,
        head_dim=size.head_dim,
        tie_word_embeddings=size.tied,
        bos_token_id=None,
        eos_token_id=tokenizer.token_to_id("<|im_end|>"),
        pad_token_id=tokenizer.token_to_id("<|endoftext|>"),
        dtype=torch.bfloat16,
    )
    with torch.device(device):
        model = transformers.Qwen3ForCausalLM(config).bfloat16()
    model.save_pretrained(folder)
    return folder


def write_random_ulip2(path: Path, config: PointBertConfig = ULIP2, *, seed: int = 0) -> Path:
    """A file that :func:`~model.prediction.arti4urdf.published_weights.load_point_bert` reads;
    gives it."""
    torch.manual_seed(seed)
    state = PointBert(config).state_dict()
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(
        {"state_dict": {ENCODER_PREFIX + name: value for name, value in state.items()}}, path
    )
    return path


def _tokenizer(texts: Iterable[str], most: int) -> Tokenizer:
    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence([  # type: ignore[assignment]
        pre_tokenizers.Split(Regex(_WORDS), "isolated"),
        pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
    ])  # fmt: skip
    tokenizer.decoder = decoders.ByteLevel()  # type: ignore[assignment]
    trainer = trainers.BpeTrainer(
        vocab_size=most,
        special_tokens=list(_SPECIAL),
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    tokenizer.train_from_iterator(texts, trainer)
    return tokenizer
