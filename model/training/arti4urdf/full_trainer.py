"""Training of the paper-size model, in one process or many (Hugging Face accelerate).

Source: ArtiWorld (CVPR 2026), training: Adam, learning rate 1e-5, 20 epochs, bfloat16, gradient
checkpointing, one object per GPU on eight GPUs. The encoder is frozen.
"""

from __future__ import annotations

import json
import math
import pickle
import shutil
import zlib
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch.utils.data import DataLoader

from model.core.errors import ConfigurationError
from model.core.files import write_json
from model.core.progress import Progress, no_progress
from model.prediction.arti4urdf.full_model import FullModel, LoraSettings, make_full_model
from model.training.arti4urdf.config import (
    CONFIG,
    FullConfig,
    append_entry,
    check_size,
    rate,
    require_extras,
    run_steps,
    same_config,
    set_rate,
)
from model.training.arti4urdf.full_data import TOO_LONG, Drawn, Draws, ObjectSet, positions

STATE = "state.json"
LEFT_OUT = "left_out.jsonl"


@dataclass(frozen=True)
class Sources:
    """Weights and objects of a run.

    Attributes:
        point_encoder: a checkpoint of ULIP-2. language_model: a folder of Qwen3.
        objects: for training. held: for validation.
        jobs: processes that make objects for each training process; 0 for none.
    """

    point_encoder: Path
    language_model: Path
    objects: ObjectSet
    held: ObjectSet
    jobs: int = 0


@dataclass(frozen=True)
class Finished:
    """The result of a slice.

    Attributes:
        step: that was reached. steps: of the whole run.
        loss: mean of the last log entry; NaN without a step.
        left_out: reason → number of objects, over all slices.
    """

    step: int
    steps: int
    loss: float
    left_out: dict[str, int]


def train_full(
    config: FullConfig,
    sources: Sources,
    out: Path,
    *,
    seconds: float = math.inf,
    weights: Path | None = None,
    progress: Progress = no_progress,
) -> Finished:
    """Train, or resume where the last slice ended.

    Args:
        config: the run; it is written beside the state and must not change between slices.
        sources: weights and objects.
        out: folder of the run. seconds: stop (and save) after this long.
        weights: folder for the model at the end of the slice.
        progress: of the main process.

    Raises:
        InputFileError: if weights are absent or don't fit the preset.
        ConfigurationError: if packages are missing, the batch can't be shared among the
            processes, ``out`` holds another run, or no object is usable.
    """
    require_extras(config)
    from transformers.utils.logging import disable_progress_bar

    disable_progress_bar()  # progress reports the same
    check_size(config, sources.language_model)
    config = _resolved(config, len(sources.objects))
    trainer = _FullTrainer(config, sources, out)
    means = run_steps(trainer, config, seconds, progress if trainer.main else no_progress)
    if weights is not None:
        trainer.export(weights)
    trainer.accelerator.end_training()
    loss = means.get("loss", math.nan)
    return Finished(trainer.step, config.steps, loss, trainer.left_out())


def _resolved(config: FullConfig, objects: int) -> FullConfig:
    """The configuration with its number of steps, and a warm-up within them."""
    steps = config.steps or math.ceil(config.epochs * objects / config.batch)
    return replace(config, steps=steps, warmup=min(config.warmup, steps))


def load_model(config: FullConfig, point_encoder: Path, language_model: Path) -> FullModel:
    """The untrained model, ready for the optimiser.

    Trained parameters are in float32: a step of 1e-5 would vanish in bfloat16's rounding.
    """
    lora = LoraSettings(config.lora_rank, 2 * config.lora_rank) if config.lora_rank else None
    torch.manual_seed(config.seed)
    frozen = torch.bfloat16 if lora and config.bfloat16 else torch.float32
    model = make_full_model(point_encoder, language_model, dtype=frozen, lora=lora)
    for parameter in model.trained_parameters():
        parameter.data = parameter.data.float()
    cut = {name: getattr(config, name) for name in ("points", "groups", "neighbours")}
    model.encoder.config = replace(model.encoder.config, **cut)
    return model


class _FullTrainer:
    """One process of a run; see :class:`model.training.arti4urdf.config.Trainer`."""

    def __init__(self, config: FullConfig, sources: Sources, out: Path) -> None:
        from accelerate import Accelerator
        from accelerate.utils import DistributedType

        self.config, self.sources, self.out = config, sources, out
        # The configuration decides on the precision, not accelerate's launcher.
        self.accelerator: Any = Accelerator(mixed_precision="bf16" if config.bfloat16 else "no")
        self.main = self.accelerator.is_main_process
        processes = self.accelerator.num_processes
        self._share, rest = divmod(config.batch, processes)
        if rest:
            raise ConfigurationError(
                f"a batch of {config.batch} can't be divided among {processes} processes: "
                f"--set batch={processes * (self._share + 1)}"
            )
        if self.main:
            out.mkdir(parents=True, exist_ok=True)
            same_config(self._record(), out, free=("paths",))
        self.accelerator.wait_for_everyone()
        model = load_model(config, sources.point_encoder, sources.language_model)
        if config.checkpointing:
            model.use_gradient_checkpointing()
        self._tokenizer = model.tokenizer
        self._sharded = self.accelerator.distributed_type == DistributedType.FSDP
        if self._sharded:
            # Small and frozen: every process holds it in full.
            model.encoder.to(self.accelerator.device)
            self.accelerator.state.fsdp_plugin.ignored_modules = [model.encoder]
        optimizer = torch.optim.Adam(model.trained_parameters(), lr=config.learning_rate)
        self.model, self.optimizer = self.accelerator.prepare(model, optimizer)
        self._frozen = {
            name
            for name, value in self.model.named_parameters(remove_duplicate=False)
            if not value.requires_grad
        }
        self._reported: set[str] = set()
        self.step = self._restored()
        self.model.train()
        count = config.steps * config.batch
        draws = Draws(sources.objects, config, self._tokenizer, count)
        self.batches = self._batches(draws, range(self.step, config.steps))

    def _record(self) -> dict[str, Any]:
        """The resolved configuration, with a checksum of the objects."""
        objects, paths = self.sources.objects, self.sources
        names = "\n".join(objects.name(k) for k in range(len(objects)))
        return {
            **asdict(self.config),
            "objects": len(objects),
            "objects_crc": zlib.crc32(names.encode()),
            "seeds": {"objects": objects.seed, "validation": self.sources.held.seed},
            "paths": {
                "point_encoder": str(paths.point_encoder),
                "language_model": str(paths.language_model),
            },
        }

    def train_step(self, step: int) -> dict[str, float] | None:
        """One step of the optimiser over ``share`` objects here; the loss over all processes."""
        config, total = self.config, torch.zeros((), device=self.accelerator.device)
        set_rate(self.optimizer, config, step)
        self.optimizer.zero_grad(set_to_none=True)
        for turn in range(self._share):
            drawn = self._taken(next(self.batches))
            # Dropout depends on the object's position alone, so that a resumed run draws the same.
            torch.manual_seed(config.seed * 1_000_003 + drawn.position)
            last = turn + 1 == self._share
            with nullcontext() if last else self.accelerator.no_sync(self.model):
                loss = self.model([drawn.example])
                self.accelerator.backward(loss / self._share)
            total += loss.detach().float() / self._share
        norm = self.accelerator.clip_grad_norm_(self.model.parameters(), 1.0)
        if not bool(torch.isfinite(norm)):
            return None
        self.optimizer.step()
        return {"loss": float(self.accelerator.reduce(total, "mean"))}

    def _batches(self, draws: Draws, steps: range) -> Iterator[list[Drawn]]:
        """Examples one by one: this process's share of every step."""
        accelerator = self.accelerator
        order = positions(
            self.config.batch, steps, accelerator.process_index, accelerator.num_processes
        )
        jobs = self.sources.jobs
        loader: DataLoader[Drawn] = DataLoader(
            draws,
            sampler=order,
            batch_size=1,
            collate_fn=list,
            num_workers=jobs,
            multiprocessing_context="spawn" if jobs else None,
        )
        return iter(loader)  # type: ignore[return-value]

    def _taken(self, batch: list[Drawn]) -> Drawn:
        (drawn,) = batch
        new = [(name, why) for name, why in drawn.left_out if name not in self._reported]
        if new:
            self._reported |= {name for name, _ in new}
            with (self.out / LEFT_OUT).open("a") as stream:
                stream.writelines(json.dumps({"object": n, "why": w}) + "\n" for n, w in new)
        if drawn.example is None:
            name, why = drawn.left_out[-1]
            raise ConfigurationError(
                f"{len(drawn.left_out)} objects in a row are unusable, see {self.out / LEFT_OUT}; "
                f"the last was {name}: {why}"
            )
        return drawn

    def any_process(self, flag: bool) -> bool:
        """See the protocol: all processes must stop at the same step."""
        found = torch.tensor(float(flag), device=self.accelerator.device)
        return bool(self.accelerator.reduce(found, "sum") > 0)

    @torch.no_grad()
    def _validation(self) -> float:
        """Mean loss over validation objects, divided among the processes."""
        world = self.accelerator.num_processes
        count = len(self.sources.held) // world
        draws = Draws(self.sources.held, self.config, self._tokenizer, count * world)
        total = torch.zeros((), device=self.accelerator.device)
        self.model.eval()
        for k in range(count):
            drawn = self._taken([draws[k * world + self.accelerator.process_index]])
            total += self.model([drawn.example]).float() / count
        self.model.train()
        return float(self.accelerator.reduce(total, "mean")) if count else math.nan

    def save_entry(self, means: dict[str, float], speed: float, skipped: int) -> None:
        """See the protocol."""
        values = {**means, "valid loss": self._validation()}
        entry: dict[str, float] = {k: round(v, 4) for k, v in values.items() if math.isfinite(v)}
        entry |= {"step": self.step, "speed": round(speed, 3), "skipped": skipped}
        entry |= {"rate": rate(self.config, self.step - 1), **self.left_out()}
        if self.main:
            append_entry(self.out, entry)
        self._save()

    def left_out(self) -> dict[str, int]:
        """Reason → number of objects that were left out so far."""
        path = self.out / LEFT_OUT
        lines = path.read_text().splitlines() if path.exists() else []
        entries = map(json.loads, lines)
        reasons = {entry["object"]: entry["why"].partition(":")[0] for entry in entries}
        long = sum(why == TOO_LONG for why in reasons.values())
        return {TOO_LONG: long, "unusable": len(reasons) - long}

    def _save(self) -> None:
        """Write the state; the previous one stays until this one is complete."""
        accelerator, folder = self.accelerator, self.out / f"state-{self.step:08d}"
        if self.main:
            shutil.rmtree(folder, ignore_errors=True)
        accelerator.wait_for_everyone()
        # Frozen weights are read from their own files again.
        hook = accelerator.register_save_state_pre_hook(self._only_trained)
        accelerator.save_state(str(folder), safe_serialization=False)
        hook.remove()
        accelerator.wait_for_everyone()
        if not self.main:
            return
        write_json(self.out / STATE, {"step": self.step, "folder": folder.name})
        for old in self.out.glob("state-*"):
            if old != folder:
                shutil.rmtree(old, ignore_errors=True)

    def _only_trained(self, _: Any, states: list[dict[str, Any]], __: str) -> None:
        for state in states:  # none where the model is sharded
            for name in self._frozen & set(state):
                del state[name]

    def _restored(self) -> int:
        """Read the last state; returns its step, 0 for a new run."""
        path = self.out / STATE
        if not path.exists():
            return 0
        try:
            saved = json.loads(path.read_text())
            options = {} if self._sharded else {"strict": False}
            self.accelerator.load_state(str(self.out / saved["folder"]), **options)
            return int(saved["step"])
        except (
            OSError,
            EOFError,
            pickle.UnpicklingError,
            RuntimeError,
            ValueError,
            KeyError,
            TypeError,
        ) as error:
            first = str(error).strip().splitlines()[:1] or [type(error).__name__]
            raise ConfigurationError(
                f"the state of {path} can't be read ({first[0][:200]}); delete that file to start "
                "again"
            ) from error

    def export(self, folder: Path) -> None:
        """Write a folder for ``qwen3:FOLDER``, with the configuration of the run."""
        state = self.accelerator.get_state_dict(self.model)
        if self.main:
            model = load_model(self.config, self.sources.point_encoder, self.sources.language_model)
            model.load_state_dict({k: v.cpu() for k, v in state.items()})
            if self.config.bfloat16:
                model.language_model.to(torch.bfloat16)
            model.save(folder)
            shutil.copyfile(self.out / CONFIG, folder / "training.json")
        self.accelerator.wait_for_everyone()
