"""Qwen3 from a local folder; nothing is downloaded or sent."""

from __future__ import annotations

import multiprocessing
import signal
import threading
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import resource_tracker
from pathlib import Path

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.progress import Progress
from model.evaluation.pool import kill_pool
from model.scenes.finder_options import FinderOptions
from model.scenes.language_finder import Answer, FinderUnavailableError, LanguageFinder


class QwenEngine:
    """See :class:`~model.scenes.language_finder.ChatEngine`.

    The weights live in a process of their own: what a network starts must not be there when the
    conversion forks its workers, and its memory is given back after the last question.

    Args:
        folder: of a Qwen3 model (``config.json``, ``*.safetensors``, ``tokenizer.json``).
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder.absolute()
        self.name = f"qwen3:{self._folder}"
        self.batch = self.parallel = 1
        self._pool: ProcessPoolExecutor | None = None
        self._starting = threading.Lock()

    def ask(self, system: str, user: str) -> Answer:
        """See :class:`~model.scenes.language_finder.ChatEngine`."""
        try:
            text, problem = self._submitted(system, user).result()
        except BrokenProcessPool as error:
            self.close()
            raise FinderUnavailableError(
                f"{self.name}: its process died (out of memory?); its answers so far are kept"
            ) from error
        if problem is not None:
            raise ConfigurationError(problem)
        return Answer(text)

    def _submitted(self, system: str, user: str) -> Future[tuple[str, str | None]]:
        # Ignore Ctrl+C in the model's process, which starts here: its parent closes it.
        resource_tracker.ensure_running()  # on its start it lets interrupts through again
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            with self._starting:
                if self._pool is None:
                    context = multiprocessing.get_context("spawn")
                    self._pool = ProcessPoolExecutor(1, mp_context=context)
                return self._pool.submit(_decide, self._folder, system, user)
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def close(self) -> None:
        """See :class:`~model.scenes.language_finder.ChatEngine`."""
        with self._starting:  # a process that is being started is not among the pool's yet
            pool, self._pool = self._pool, None
        if pool is not None:
            # Between two tokens it could listen, but one look at a long prompt takes long, too.
            kill_pool(pool)


def _decide(folder: Path, system: str, user: str) -> tuple[str, str | None]:
    """Runs in the model's process; the second value is the folder's problem, if any."""
    from model.prediction.arti4urdf.json_writer import load_json_writer  # torch

    try:
        return load_json_writer(folder).decide(system, user), None
    except ArtiworldError as error:
        return "", str(error)


def qwen_finder(folder: str, options: FinderOptions, progress: Progress) -> LanguageFinder:
    """A finder that asks the Qwen3 model in ``folder``."""
    return LanguageFinder(QwenEngine(Path(folder)), options.cache, progress=progress)
