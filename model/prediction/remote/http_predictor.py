"""A predictor that asks a backend (``artiworld backend``) over HTTP."""

from __future__ import annotations

import http.client
import json
import os
import ssl
from collections.abc import Iterator
from contextlib import closing, suppress
from dataclasses import replace
from typing import Any
from urllib.parse import urlsplit

from model.core.articulated_object import Prediction, SegmentedObject
from model.core.errors import ArtiworldError, ConfigurationError
from model.core.joint import Joint
from model.core.progress import Cancelled, Progress, no_progress
from model.prediction.remote import TOKEN_VARIABLE
from model.prediction.remote.wire import (
    CONTENT_TYPE,
    HEALTH_PATH,
    PREDICT_PATH,
    decode_answer,
    encode_request,
)

CONNECT_SECONDS = 10.0
SILENCE_SECONDS = 30.0
"""A backend sends a line every second, even while it serves others."""
_BLOCK = 2**18
MAX_LINE = 64 * 2**20
MOST_LINES = 100_000
"""One a second over a day."""
_LOCALLY = "predict on this machine instead"


class BackendError(ArtiworldError):
    """A backend can't be reached, refuses, or breaks off."""


class BackendRefused(BackendError):
    """A backend denies access to this client."""


class HttpPredictor:
    """Predicts on another machine.

    Args:
        url: such as ``http://gpu.example.org:8090``, perhaps with a path in front of the API.
        token: of the backend; the environment's :data:`TOKEN_VARIABLE` by default.
        connect_seconds: timeout of the connection.
        silence_seconds: timeout between two lines of the answer.

    Raises:
        ConfigurationError: if the address or the token is invalid.
    """

    def __init__(
        self,
        url: str,
        token: str | None = None,
        *,
        connect_seconds: float = CONNECT_SECONDS,
        silence_seconds: float = SILENCE_SECONDS,
    ) -> None:
        try:
            parts = urlsplit(url)
            self._host, self._port = parts.hostname, parts.port
        except ValueError as error:
            raise ConfigurationError(f"backend {url!r}: invalid address ({error})") from error
        if parts.scheme not in ("http", "https") or not self._host:
            raise ConfigurationError(
                f"backend {url!r}: invalid address; give one like http://gpu.example.org:8090"
            )
        if "@" in parts.netloc or parts.query or parts.fragment:
            raise ConfigurationError(
                "a backend's address must not contain a login, query or fragment; "
                f"give the token by --token or {TOKEN_VARIABLE}"
            )
        token = token or os.environ.get(TOKEN_VARIABLE) or None
        if token is not None and not (token.isascii() and token.isprintable()):
            raise ConfigurationError("a backend's token must consist of printable ASCII characters")
        self._secure = parts.scheme == "https"
        self._path = parts.path.rstrip("/")
        self._token = token
        self._connect_seconds, self._silence_seconds = connect_seconds, silence_seconds
        self.url = f"{parts.scheme}://{parts.netloc}{self._path}"
        self.name = self.url

    def check(self) -> dict[str, Any]:
        """The backend's health report.

        Raises:
            BackendError: if it can't be reached, is something else, or refuses the token.
        """
        with closing(self._connection()) as connection:
            response = self._ask(connection, "GET", HEALTH_PATH)
            try:
                health = json.loads(response.read(MAX_LINE))
            except (OSError, http.client.HTTPException, ValueError, RecursionError) as error:
                raise BackendError(f"{self.url} is no ArtiWorld backend") from error
        if not isinstance(health, dict) or health.get("service") != "artiworld backend":
            raise BackendError(f"{self.url} is no ArtiWorld backend")
        if health.get("token_needed") and self._token is None:
            raise BackendRefused(
                f"the backend {self.url} needs a token; give it by --token or {TOKEN_VARIABLE}"
            )
        return health

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """See :class:`model.prediction.protocol.Predictor`. Cancelling closes the connection,
        which stops the backend.

        Raises:
            BackendError: if the backend can't be reached, refuses or breaks off.
            ArtiworldError: if it can't use the parts.
        """
        progress(0.0, f"Reaching {self.url}")
        limit = self.check().get("max_bytes")
        body = encode_request(segmented, locked, seed)
        if isinstance(limit, int) and len(body) > limit:
            raise BackendError(
                f"{segmented.name} has {len(body) / 1e6:.0f} MB, the backend {self.url} accepts "
                f"at most {limit / 1e6:.0f} MB; {_LOCALLY}"
            )
        with closing(self._connection()) as connection:
            response = self._ask(connection, "POST", PREDICT_PATH, body, progress)
            data = self._follow(response, progress)
        progress(1.0, "Reading the answer")
        try:
            answer = decode_answer(data, segmented)
        except ArtiworldError as error:
            raise BackendError(f"invalid answer of the backend {self.url}: {error}") from error
        return replace(answer, backend=f"{answer.backend} at {self.url}")

    def _connection(self) -> http.client.HTTPConnection:
        assert self._host is not None
        if self._secure:
            return http.client.HTTPSConnection(
                self._host, self._port, timeout=self._connect_seconds
            )
        return http.client.HTTPConnection(self._host, self._port, timeout=self._connect_seconds)

    def _ask(
        self,
        connection: http.client.HTTPConnection,
        method: str,
        path: str,
        body: bytes = b"",
        progress: Progress = no_progress,
    ) -> http.client.HTTPResponse:
        """Send a request; returns the response if its status is 200."""
        headers = {"Accept": "application/x-ndjson, application/json"}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        if body:
            headers |= {"Content-Type": CONTENT_TYPE, "Content-Length": str(len(body))}
        try:
            connection.connect()
            assert connection.sock is not None
            connection.sock.settimeout(self._silence_seconds)
            # It may answer before the request is complete, as when its queue is full.
            with suppress(BrokenPipeError, ConnectionResetError):
                connection.request(method, self._path + path, self._blocks(body, progress), headers)
            response = connection.getresponse()
        except TimeoutError as error:
            raise BackendError(self._unreachable("no answer")) from error
        except ssl.SSLError as error:
            raise BackendError(
                self._unreachable(f"no secure connection: {error.reason}")
            ) from error
        except (OSError, http.client.HTTPException) as error:
            why = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise BackendError(self._unreachable(why)) from error
        if response.status != 200:
            raise self._refusal(response)
        return response

    def _blocks(self, body: bytes, progress: Progress) -> Iterator[bytes] | None:
        if not body:
            return None

        def blocks() -> Iterator[bytes]:
            for begin in range(0, len(body), _BLOCK):
                progress(0.05 * begin / len(body), f"Sending {len(body) / 1e6:.1f} MB")
                yield body[begin : begin + _BLOCK]

        return blocks()

    def _follow(self, response: http.client.HTTPResponse, progress: Progress) -> object:
        """Report progress line by line; returns the value of "done"."""
        for _ in range(MOST_LINES):
            try:
                line = response.readline(MAX_LINE)
                message = json.loads(line) if line.endswith(b"\n") else None
            except TimeoutError as error:
                raise BackendError(
                    self._unreachable(f"no line for {self._silence_seconds:g} s")
                ) from error
            except (OSError, http.client.HTTPException) as error:
                raise BackendError(self._unreachable("connection lost")) from error
            except (ValueError, RecursionError) as error:
                raise BackendError(f"invalid answer of the backend {self.url}") from error
            if not isinstance(message, dict):
                raise BackendError(self._unreachable("the answer broke off"))
            if "done" in message:
                return message["done"]
            if "error" in message:
                raise self._error(message)
            fraction, text = _progress_of(message)
            progress(0.05 + 0.95 * fraction, text)
        raise BackendError(f"the backend {self.url} doesn't come to an end; {_LOCALLY}")

    def _error(self, message: dict[str, Any]) -> Exception:
        text = str(message["error"])[:2000]
        if message.get("kind") == "user":
            return ArtiworldError(text)
        if message.get("kind") == "cancelled":
            return Cancelled(text)
        return BackendError(f"the backend {self.url} failed: {text}; {_LOCALLY}")

    def _refusal(self, response: http.client.HTTPResponse) -> ArtiworldError:
        try:
            message = json.loads(response.read(_BLOCK))
            text = str(message["error"])[:2000]
        except (
            OSError, http.client.HTTPException, ValueError, KeyError, TypeError, RecursionError,
        ):  # fmt: skip
            return BackendError(
                f"{self.url} answered {response.status} {response.reason}: is it a backend?"
            )
        if response.status == 401:
            return BackendRefused(
                f"the backend {self.url} refuses the token; check --token or {TOKEN_VARIABLE}"
            )
        return BackendError(f"the backend {self.url} refused: {text}")

    def _unreachable(self, why: str) -> str:
        return f"the backend {self.url} can't be reached ({why}); {_LOCALLY}"


def _progress_of(message: dict[str, Any]) -> tuple[float, str]:
    try:
        fraction, text = message["progress"]
        return min(max(float(fraction), 0.0), 1.0), str(text)[:200]
    except (KeyError, TypeError, ValueError):
        return 0.0, ""
