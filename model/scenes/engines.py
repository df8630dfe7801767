"""Language models that find articulable objects: a server, or Qwen3 from a local folder.

A server speaks OpenAI's chat protocol: vLLM, Ollama, a cloud. It may be a stranger's, so answers
are of limited size and time, and no redirect is followed. Of a local model nothing is downloaded or
sent.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from model.core.errors import ArtiworldError, ConfigurationError
from model.core.packages import require
from model.core.pool import kill_pool
from model.core.progress import Progress
from model.scenes.articulable_finders import FinderOptions
from model.scenes.language_finder import SCHEMA, Answer, FinderUnavailableError, LanguageFinder

MOST_BYTES = 16 << 20
"""Largest answer; a model's longest takes less than one."""


def bounded_client(timeout: float) -> Any:
    """An ``httpx.Client`` whose answers end.

    A redirect isn't followed, as it would take a question, and with some clients the key, to a
    place that nobody named.

    Args:
        timeout: seconds until an answer is complete.
    """
    httpx = require("httpx", "artiworld[finder]", "asking a language model")

    class Bounded(httpx.BaseTransport):
        """Reads each answer whole, within limits."""

        def __init__(self) -> None:
            self._inner = httpx.HTTPTransport()

        def handle_request(self, request: Any) -> Any:
            request.headers["accept-encoding"] = "identity"  # what is packed may unpack to anything
            ends = time.monotonic() + timeout
            response = self._inner.handle_request(request)
            try:
                if response.headers.get("content-encoding", "identity") != "identity":
                    raise httpx.DecodingError("the answer is packed", request=request)
                body = bytearray()
                for block in response.stream:
                    body += block
                    if len(body) > MOST_BYTES:
                        raise httpx.DecodingError(
                            f"the answer has more than {MOST_BYTES >> 20} MiB", request=request
                        )
                    if time.monotonic() > ends:
                        raise httpx.ReadTimeout("the answer doesn't end", request=request)
            finally:
                response.close()
            return httpx.Response(
                response.status_code, headers=response.headers, content=bytes(body), request=request
            )

        def close(self) -> None:
            self._inner.close()

    return httpx.Client(transport=Bounded(), timeout=timeout, follow_redirects=False)


T = TypeVar("T")

KEY_VARIABLE, URL_VARIABLE = "OPENAI_API_KEY", "OPENAI_BASE_URL"
"""Environment variables; the key is taken from nowhere else."""

_FORM = {
    "type": "json_schema",
    "json_schema": {"name": "articulable_objects", "strict": True, "schema": SCHEMA},
}
# Servers that lack an option refuse it with 400 or 422; the first form that one takes is kept.
_FORMS: tuple[dict[str, Any], ...] = (
    {"response_format": _FORM, "temperature": 0.0},
    {"response_format": _FORM},
    {"response_format": {"type": "json_object"}},
    {},
)


class OpenAiEngine:
    """See :class:`~model.scenes.language_finder.ChatEngine`.

    429, 5xx, timeouts and broken connections are tried again with growing pauses, or when the
    server says (``Retry-After``), by the client of the package ``openai``.

    Args:
        model: as the server calls it.
        url: of the server, such as ``http://localhost:11434/v1``; by default that of
            :data:`URL_VARIABLE`, else OpenAI's.
        batch, parallel: see :class:`~model.scenes.language_finder.ChatEngine`.
        timeout: seconds without an answer.
        retries: after the first try.
        asks: whether it will be asked at all; else neither the package nor a key is needed.

    Raises:
        ConfigurationError: where the package is missing, or the key that the server needs.
    """

    def __init__(
        self,
        model: str,
        url: str | None = None,
        *,
        batch: int = 20,
        parallel: int = 4,
        timeout: float = 120.0,
        retries: int = 5,
        asks: bool = True,
    ) -> None:
        url = url or os.environ.get(URL_VARIABLE)
        if url is not None and not url.startswith(("http://", "https://")):
            raise ConfigurationError(f"{url!r} is no address; as in http://localhost:11434/v1")
        self.name = f"openai:{model}" if url is None else f"openai:{model} at {url.rstrip('/')}"
        self.model, self.batch, self.parallel = model, batch, parallel
        self._client: Any = _client(url, timeout, retries) if asks else None
        self._form = 0
        self._under_way: set[Future[Answer]] = set()

    def ask(self, system: str, user: str) -> Answer:
        """See :class:`~model.scenes.language_finder.ChatEngine`."""
        answer: Future[Answer] = Future()
        self._under_way.add(answer)
        # A thread that waits for a server can't be stopped; as a daemon it doesn't block the exit.
        Thread(target=self._ask_for, args=(answer, system, user), daemon=True).start()
        try:
            return answer.result()
        finally:
            self._under_way.discard(answer)

    def _ask_for(self, answer: Future[Answer], system: str, user: str) -> None:
        try:
            said = self._ask(system, user)
        except Exception as error:  # a thread's boundary: whoever asked gets it
            _unless_given_up(answer.set_exception, error)
        else:
            _unless_given_up(answer.set_result, said)

    def _ask(self, system: str, user: str) -> Answer:
        import openai

        messages = [{"role": "system", "content": system}, {"role": "user", "content": user}]
        form = self._form
        while True:
            try:
                said = self._client.chat.completions.create(
                    model=self.model,
                    messages=messages,
                    **_FORMS[form],  # type: ignore[arg-type]
                )
                self._form = max(self._form, form)
                return _answer(said)
            except (openai.BadRequestError, openai.UnprocessableEntityError) as error:
                form += 1
                if form == len(_FORMS):
                    raise ConfigurationError(f"{self.name} refuses: {_first(error)}") from error
            except (openai.AuthenticationError, openai.PermissionDeniedError) as error:
                raise ConfigurationError(
                    f"{self.name} refuses the key; set {KEY_VARIABLE} ({_first(error)})"
                ) from error
            except openai.NotFoundError as error:
                raise ConfigurationError(
                    f"{self.name} isn't there: check the model's name and that the address ends "
                    f"as the server wants it, mostly in /v1 ({_first(error)})"
                ) from error
            except openai.OpenAIError as error:
                target = _redirect_of(error)
                if target:
                    raise ConfigurationError(
                        f"{self.name} redirects to {target!r}, which isn't followed; give that "
                        "address if you trust it"
                    ) from error
                raise FinderUnavailableError(
                    f"{self.name} can't be asked ({_first(error)}); its answers so far are kept, "
                    "so run again when it can"
                ) from error
            except (ValueError, RecursionError):  # the server's own envelope is no JSON
                return Answer("")

    def close(self) -> None:
        """See :class:`~model.scenes.language_finder.ChatEngine`; its connections close alone."""
        given_up = FinderUnavailableError(f"{self.name} wasn't waited for")
        for answer in list(self._under_way):
            _unless_given_up(answer.set_exception, given_up)


def _client(url: str | None, timeout: float, retries: int) -> Any:
    openai = require("openai", "artiworld[finder]", "asking a language model")
    key = os.environ.get(KEY_VARIABLE)
    if not key and url is None:
        raise ConfigurationError(
            f"set {KEY_VARIABLE} for OpenAI, or give the address of your own server"
        )
    # A server of one's own needs no key, but the client wants one.
    return openai.OpenAI(
        api_key=key or "none",
        base_url=url,
        timeout=timeout,
        max_retries=retries,
        http_client=bounded_client(timeout),
    )


def _unless_given_up(give: Callable[[T], None], value: T) -> None:
    """Nobody waits for an answer that was given up."""
    with suppress(InvalidStateError):
        give(value)


def _answer(said: Any) -> Answer:
    """The text in an answer; servers send anything."""
    try:
        text = said.choices[0].message.content
    except (AttributeError, IndexError, KeyError, TypeError):
        return Answer("")
    usage = getattr(said, "usage", None)
    tokens = [getattr(usage, k, 0) for k in ("prompt_tokens", "completion_tokens")]
    counts = [t if isinstance(t, int) and t > 0 else 0 for t in tokens]
    return Answer(text if isinstance(text, str) else "", *counts)


def _redirect_of(error: Exception) -> str:
    """Address that a server redirects to, "" without one."""
    response = getattr(error, "response", None)
    if response is None or not 300 <= response.status_code < 400:
        return ""
    return str(response.headers.get("location", ""))[:200]


def _first(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0][:200]


def openai_finder(model: str, options: FinderOptions, progress: Progress) -> LanguageFinder:
    """A finder that asks ``model`` on the server that ``options`` name."""
    engine = OpenAiEngine(
        model,
        options.url,
        batch=options.batch,
        timeout=options.timeout,
        retries=options.retries,
        asks=options.asks,
    )
    return LanguageFinder(engine, options.cache, progress=progress)


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
    from model.prediction.arti4urdf.text_writing import load_json_writer  # torch

    try:
        return load_json_writer(folder).decide(system, user), None
    except ArtiworldError as error:
        return "", str(error)


def qwen_finder(folder: str, options: FinderOptions, progress: Progress) -> LanguageFinder:
    """A finder that asks the Qwen3 model in ``folder``."""
    return LanguageFinder(QwenEngine(Path(folder)), options.cache, progress=progress)
