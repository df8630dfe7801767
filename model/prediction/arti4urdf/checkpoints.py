"""Weights on disk: our own checkpoint folders, published ones, and random ones of their sizes.

Our own checkpoint is a folder of two files: ``config.json`` (with a format number) and
``weights.safetensors``. Published are a ULIP-2 checkpoint and a Qwen3 folder; nothing is
downloaded. Random weights in the published formats show what a machine can run before gigabytes
are downloaded.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
import pickle
import re
import zipfile
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import save_file
from torch import Tensor

from model.core import codec
from model.core.errors import InputFileError
from model.core.files import draft_of, read_safetensors, strict_load
from model.prediction.arti4urdf.language_model import Decoder, DecoderConfig
from model.prediction.arti4urdf.point_bert import ULIP2, PointBert, PointBertConfig

if TYPE_CHECKING:
    from tokenizers import Tokenizer

FORMAT = 1
CONFIG_FILE = "config.json"
WEIGHTS_FILE = "weights.safetensors"
MAX_CONFIG_BYTES = 50_000_000

D = TypeVar("D")


@dataclasses.dataclass(frozen=True, eq=False)
class Checkpoint:
    """The contents of a checkpoint folder.

    Attributes:
        folder: of the files. config: ``config.json`` without the format.
        state: tensors by name.
    """

    folder: Path
    config: Mapping[str, Any]
    state: Mapping[str, Tensor]


def save_checkpoint(
    folder: Path,
    config: Mapping[str, Any],
    state: Mapping[str, Tensor],
    *,
    dtype: torch.dtype = torch.bfloat16,
) -> None:
    """Write a checkpoint folder; each file appears whole or not at all.

    Matrices are written as ``dtype``; vectors (norms, biases) keep their precision. Tensors that
    share memory are written separately.

    Raises:
        InputFileError: if the folder can't be written.
    """
    small = {
        name: (value.to(dtype) if value.is_floating_point() and value.ndim > 1 else value)
        .detach()
        .cpu()
        .contiguous()
        .clone()
        for name, value in state.items()
    }
    text = json.dumps({"format": FORMAT, **config}, indent=2, ensure_ascii=False, allow_nan=False)
    try:
        with draft_of(folder / WEIGHTS_FILE) as weights:
            save_file(small, weights, metadata={"format": "pt"})
        with draft_of(folder / CONFIG_FILE) as draft:
            draft.write_text(text + "\n")
    except (OSError, SafetensorError) as error:
        raise InputFileError(folder, f"the checkpoint can't be written: {error}") from error


def load_checkpoint(folder: Path) -> Checkpoint:
    """Read what :func:`save_checkpoint` wrote.

    Raises:
        InputFileError: if a file is absent, damaged or of a newer format.
    """
    path = folder / CONFIG_FILE
    config = read_json(path)
    found = config.pop("format", None)
    if found != FORMAT:
        raise InputFileError(
            path, f"checkpoint format {found!r}", f"this version reads format {FORMAT}"
        )
    return Checkpoint(folder, config, read_safetensors(folder / WEIGHTS_FILE))


def read_json(path: Path) -> dict[str, Any]:
    """The JSON object in a file.

    Raises:
        InputFileError: if the file is absent, huge or no JSON object.
    """
    try:
        if path.stat().st_size > MAX_CONFIG_BYTES:
            raise InputFileError(path, "is far too large for a configuration")
        value = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(path, f"can't be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        raise InputFileError(path, f"is not JSON ({error})") from error
    if not isinstance(value, dict):
        raise InputFileError(path, "is not a JSON object")
    return value


def from_config(kind: type[D], values: object, path: Path) -> D:
    """A configuration from the values of ``dataclasses.asdict``.

    Raises:
        InputFileError: if a value is missing, unknown or invalid.
    """
    try:
        return codec.read(kind, values, kind.__name__)
    except ValueError as error:  # of the codec, or of the class
        raise InputFileError(path, str(error)) from error


ENCODER_PREFIX = "module.point_encoder."
TOKENIZER_FILE = "tokenizer.json"
_BLOCK = re.compile(r"blocks\.blocks\.(\d+)\.")
_QWEN_REMEDY = "give a folder of Qwen3 (0.6B to 8B) with config.json, *.safetensors, tokenizer.json"


# --- ULIP-2 -----------------------------------------------------------------------------------


def load_point_bert(path: Path) -> PointBert:
    """Point-BERT from a checkpoint of ULIP-2 (or of PointLLM: the same with fewer blocks).

    Returns:
        The encoder in float32, in evaluation mode; its configuration is that of ULIP-2 with the
        checkpoint's depth.

    Raises:
        InputFileError: if the file is absent, damaged, unsafe or of something else.
    """
    whole = _read_torch(path)
    state = whole.get("state_dict") if isinstance(whole, Mapping) else None
    if not isinstance(state, Mapping):
        raise InputFileError(
            path, "has no 'state_dict'", "give the checkpoint that ULIP-2 publishes"
        )
    encoder = {
        name.removeprefix(ENCODER_PREFIX): value
        for name, value in state.items()
        if isinstance(name, str) and name.startswith(ENCODER_PREFIX) and torch.is_tensor(value)
    }
    if not encoder:
        raise InputFileError(
            path,
            f"has no weights called {ENCODER_PREFIX}…",
            "give a ULIP-2 checkpoint with Point-BERT as its encoder",
        )
    blocks = [int(m.group(1)) for name in encoder if (m := _BLOCK.match(name))]
    # A gap in the numbers gives missing keys; a huge number must not allocate that many blocks.
    depth = min(max(blocks, default=-1), len(blocks)) + 1
    with torch.device("meta"):
        model = PointBert(replace(ULIP2, depth=depth))
    strict_load(model, encoder, path, dtype=torch.float32)
    return model.eval()


def _read_torch(path: Path) -> Any:
    """A file of ``torch.save`` with tensors, plain values and the options of its training."""
    if not path.is_file():
        raise InputFileError(path, "no such file", "download the checkpoint first")
    scalar = np.float64(0).__reduce__()[0]
    harmless = [
        argparse.Namespace,
        np.dtype,
        type(np.dtype(np.float64)),
        type(np.dtype(np.float32)),
        scalar,
        (scalar, "numpy.core.multiarray.scalar"),
    ]
    try:
        with torch.serialization.safe_globals(harmless):
            return torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        why = re.search(r"GLOBAL ([\w.]+)", str(error))
        problem = f"contains code ({why.group(1)})" if why else "is damaged or no torch file"
        raise InputFileError(path, problem, "only tensors and plain values are read") from error
    except (
        RuntimeError,
        EOFError,
        OSError,
        ValueError,
        KeyError,
        TypeError,
        AttributeError,
        IndexError,
        zipfile.BadZipFile,
    ) as error:
        first = str(error).strip().splitlines()[:1] or [type(error).__name__]
        raise InputFileError(path, f"is damaged or no torch file ({first[0][:200]})") from error


# --- Qwen3 ------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Qwen3:
    """A language model from disk.

    Attributes:
        decoder: in evaluation mode. tokenizer: of the same folder. folder: of both.
    """

    decoder: Decoder
    tokenizer: Tokenizer
    folder: Path


def load_qwen3(folder: Path, *, dtype: torch.dtype = torch.bfloat16) -> Qwen3:
    """Qwen3 from the folder that transformers' ``save_pretrained`` or the publisher wrote.

    Raises:
        InputFileError: if a file is absent, damaged, or of another architecture.
    """
    config = read_qwen3_config(folder)
    state = _read_shards(folder)
    if config.tied:
        # Published folders of tied models may contain the shared matrix twice.
        again, shared = state.pop("lm_head.weight", None), state.get("model.embed_tokens.weight")
        if again is not None and shared is not None and not torch.equal(again, shared):
            raise InputFileError(
                folder, "config.json ties the output to the embedding, but their weights differ"
            )
    with torch.device("meta"):
        decoder = Decoder(config)
    strict_load(decoder, state, folder, dtype=dtype)
    return Qwen3(decoder.eval(), load_tokenizer(folder), folder)


def read_qwen3_config(folder: Path) -> DecoderConfig:
    """The sizes in a Qwen3 folder's ``config.json``.

    Raises:
        InputFileError: if it is of another architecture or has an unsupported option.
    """
    path = folder / "config.json"
    if not folder.is_dir():
        raise InputFileError(folder, "no such folder", _QWEN_REMEDY)
    values = read_json(path)
    if values.get("model_type") != "qwen3":
        raise InputFileError(path, f"is of {values.get('model_type')!r}, not qwen3", _QWEN_REMEDY)
    rope = values.get("rope_parameters") or values.get("rope_scaling") or {}
    for name, usual, found in (
        ("attention_bias", False, values.get("attention_bias", False)),
        ("use_sliding_window", False, values.get("use_sliding_window", False)),
        ("hidden_act", "silu", values.get("hidden_act", "silu")),
        ("rope type", "default", rope.get("rope_type", rope.get("type", "default"))),
    ):
        if found != usual:
            raise InputFileError(path, f"{name} {found!r} is not supported", f"use {usual!r}")
    try:
        heads = int(values["num_attention_heads"])
        return DecoderConfig(
            vocab_size=int(values["vocab_size"]),
            hidden_size=int(values["hidden_size"]),
            intermediate_size=int(values["intermediate_size"]),
            layers=int(values["num_hidden_layers"]),
            heads=heads,
            kv_heads=int(values["num_key_value_heads"]),
            head_dim=int(values.get("head_dim") or int(values["hidden_size"]) // heads),
            rope_theta=float(values.get("rope_theta") or rope.get("rope_theta") or 1e6),
            rms_eps=float(values.get("rms_norm_eps", 1e-6)),
            tied=bool(values.get("tie_word_embeddings", False)),
        )
    except (KeyError, TypeError, ValueError, ZeroDivisionError) as error:
        what = f"lacks {error}" if isinstance(error, KeyError) else str(error)
        raise InputFileError(path, what, _QWEN_REMEDY) from error


def _read_shards(folder: Path) -> dict[str, Tensor]:
    """All tensors of ``model.safetensors``, or of the files that its index lists."""
    index = folder / "model.safetensors.index.json"
    if not index.exists():
        return read_safetensors(folder / "model.safetensors")
    places = read_json(index).get("weight_map")
    if not isinstance(places, dict) or not places:
        raise InputFileError(index, "has no 'weight_map'")
    state: dict[str, Tensor] = {}
    for name in sorted({str(shard) for shard in places.values()}):
        if Path(name).name != name:  # an index must not lead out of its folder
            raise InputFileError(index, f"lists {name!r}, which is no file of this folder")
        state.update(read_safetensors(folder / name))
    absent = sorted(set(places) - set(state))
    if absent:
        raise InputFileError(index, f"lists {absent[0]!r}, which no shard holds")
    return state


def load_tokenizer(folder: Path) -> Tokenizer:
    """The tokenizer of a Qwen3 folder.

    Raises:
        InputFileError: if ``tokenizer.json`` is absent or damaged.
    """
    from tokenizers import Tokenizer

    path = folder / TOKENIZER_FILE
    if not path.is_file():
        raise InputFileError(path, "no such file", _QWEN_REMEDY)
    try:
        return Tokenizer.from_file(str(path))
    except Exception as error:  # the library raises nothing more precise
        raise InputFileError(path, f"is no tokenizer ({error})") from error


_WORDS = r" ?[A-Za-z]+|\d| ?[^\sA-Za-z\d]+|\s*[\r\n]+|\s+"
"""Approximately Qwen's pre-tokeniser: words, single digits, runs of signs."""
_SPECIAL = ("<|endoftext|>", "<|im_start|>", "<|im_end|>")
_TOKENS = 4000


def write_random_qwen3(
    folder: Path, size: DecoderConfig, texts: Iterable[str], *, device: str = "cpu", seed: int = 0
) -> Path:
    """A Qwen3 folder that :func:`~model.prediction.arti4urdf.checkpoints.load_qwen3` reads.

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
    """A file that :func:`~model.prediction.arti4urdf.checkpoints.load_point_bert` reads;
    gives it."""
    torch.manual_seed(seed)
    state = PointBert(config).state_dict()
    path.parent.mkdir(parents=True, exist_ok=True)
    torch.save(
        {"state_dict": {ENCODER_PREFIX + name: value for name, value in state.items()}}, path
    )
    return path


def _tokenizer(texts: Iterable[str], most: int) -> Tokenizer:
    from tokenizers import Regex, Tokenizer, decoders, models, pre_tokenizers, trainers

    tokenizer = Tokenizer(models.BPE())
    tokenizer.pre_tokenizer = pre_tokenizers.Sequence(
        [  # type: ignore[assignment]
            pre_tokenizers.Split(Regex(_WORDS), "isolated"),
            pre_tokenizers.ByteLevel(add_prefix_space=False, use_regex=False),
        ]
    )
    tokenizer.decoder = decoders.ByteLevel()  # type: ignore[assignment]
    trainer = trainers.BpeTrainer(
        vocab_size=most,
        special_tokens=list(_SPECIAL),
        initial_alphabet=pre_tokenizers.ByteLevel.alphabet(),
        show_progress=False,
    )
    tokenizer.train_from_iterator(texts, trainer)
    return tokenizer
