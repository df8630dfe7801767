"""A tiny Qwen3 with random weights on disk, written by transformers and tokenizers themselves."""

from pathlib import Path

TEXT = (
    "a door turns about its hinge, a drawer slides out; the lid of a box, the knob of an oven",
    '<robot name="box"><link name="link_0"/><joint name="j" type="revolute"></joint></robot>',
    '{"part": "link_0", "children": [{"part": "link_1", "joint_type": "prismatic"}]}',
)


def write_tiny_qwen3(folder: Path, *, tied: bool = True, shard: str = "5GB", seed: int = 0) -> Path:
    """Write config.json, safetensors and tokenizer files into ``folder``."""
    import tokenizers
    import torch
    import transformers

    words = tokenizers.Tokenizer(tokenizers.models.BPE())
    words.pre_tokenizer = tokenizers.pre_tokenizers.ByteLevel(add_prefix_space=False)
    words.decoder = tokenizers.decoders.ByteLevel()
    special = ["<|endoftext|>", "<|im_start|>", "<|im_end|>"]
    alphabet = tokenizers.pre_tokenizers.ByteLevel.alphabet()
    how = {"vocab_size": 400, "special_tokens": special, "initial_alphabet": alphabet}
    trainer = tokenizers.trainers.BpeTrainer(show_progress=False, **how)
    words.train_from_iterator(TEXT, trainer)
    wrapped = transformers.PreTrainedTokenizerFast(
        tokenizer_object=words, eos_token="<|im_end|>", pad_token="<|endoftext|>"
    )
    wrapped.save_pretrained(folder)
    torch.manual_seed(seed)
    # More rows than tokens, as the published vocabularies have.
    sizes = {"vocab_size": words.get_vocab_size() + 40, "hidden_size": 64, "intermediate_size": 96}
    sizes |= {"num_hidden_layers": 2, "num_attention_heads": 4, "num_key_value_heads": 2}
    end, pad = (words.token_to_id(f"<|{name}|>") for name in ("im_end", "endoftext"))
    ids = {"bos_token_id": None, "eos_token_id": end, "pad_token_id": pad}
    config = transformers.Qwen3Config(head_dim=16, tie_word_embeddings=tied, **sizes, **ids)
    transformers.Qwen3ForCausalLM(config).save_pretrained(folder, max_shard_size=shard)
    return folder
