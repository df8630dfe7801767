"""Any server that speaks OpenAI's chat protocol: vLLM, Ollama, a cloud."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import Future, InvalidStateError
from contextlib import suppress
from threading import Thread
from typing import Any, TypeVar

from model.core.errors import ConfigurationError
from model.core.packages import require
from model.core.progress import Progress
from model.scenes.bounded_http import bounded_client
from model.scenes.finder_options import FinderOptions
from model.scenes.language_finder import SCHEMA, Answer, FinderUnavailableError, LanguageFinder

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
                    model=self.model, messages=messages, **_FORMS[form]  # type: ignore[arg-type]
                )  # fmt: skip
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
        api_key=key or "none", base_url=url, timeout=timeout, max_retries=retries,
        http_client=bounded_client(timeout),
    )  # fmt: skip


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
        model, options.url, batch=options.batch, timeout=options.timeout,
        retries=options.retries, asks=options.asks,
    )  # fmt: skip
    return LanguageFinder(engine, options.cache, progress=progress)
