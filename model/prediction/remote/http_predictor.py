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
"""A backend says something every second, also while others are served."""
_BLOCK = 2**18
_MAX_LINE = 64 * 2**20
_HERE = "this machine can predict instead"


class BackendError(ArtiworldError):
    """A backend that can't be reached, refuses, or breaks off."""


class BackendRefused(BackendError):
    """A backend that is there, but doesn't let this client in."""


class HttpPredictor:
    """Predicts on another machine.

    Args:
        url: such as ``http://gpu.example.org:8090``, perhaps with a path in front of the API.
        token: of the backend; the environment's :data:`TOKEN_VARIABLE` by default.
        connect_seconds: how long reaching it may take.
        silence_seconds: how long it may say nothing before it counts as gone.

    Raises:
        ConfigurationError: where the address or the token can't be one.
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
            raise ConfigurationError(f"the backend {url!r} is no address ({error})") from error
        if parts.scheme not in ("http", "https") or not self._host:
            raise ConfigurationError(
                f"the backend {url!r} is no address; give one like http://gpu.example.org:8090"
            )
        if "@" in parts.netloc or parts.query or parts.fragment:
            raise ConfigurationError(
                "a backend's address holds neither a login nor a query; "
                f"give the token by --token or {TOKEN_VARIABLE}"
            )
        token = token or os.environ.get(TOKEN_VARIABLE) or None
        if token is not None and not (token.isascii() and token.isprintable()):
            raise ConfigurationError("a backend's token has ASCII letters, digits and signs only")
        self._secure = parts.scheme == "https"
        self._path = parts.path.rstrip("/")
        self._token = token
        self._connect_seconds, self._silence_seconds = connect_seconds, silence_seconds
        self.url = f"{parts.scheme}://{parts.netloc}{self._path}"
        self.name = self.url

    def check(self) -> dict[str, Any]:
        """What the backend says of itself.

        Raises:
            BackendError: where it can't be reached, is something else, or refuses the token.
        """
        with closing(self._connection()) as connection:
            response = self._ask(connection, "GET", HEALTH_PATH)
            try:
                said = json.loads(response.read(_MAX_LINE))
            except (OSError, http.client.HTTPException, ValueError) as error:
                raise BackendError(f"{self.url} is no ArtiWorld backend") from error
        if not isinstance(said, dict) or said.get("service") != "artiworld backend":
            raise BackendError(f"{self.url} is no ArtiWorld backend")
        if said.get("token_needed") and self._token is None:
            raise BackendRefused(
                f"the backend {self.url} wants a token; give it by --token or {TOKEN_VARIABLE}"
            )
        return said

    def predict(
        self,
        segmented: SegmentedObject,
        *,
        locked: tuple[Joint, ...] = (),
        seed: int = 0,
        progress: Progress = no_progress,
    ) -> Prediction:
        """As :meth:`model.prediction.protocol.Predictor.predict`; cancelling closes the
        connection, which
        stops the backend.

        Raises:
            BackendError: where the backend can't be reached, refuses or breaks off.
            ArtiworldError: where it can't use the parts.
        """
        progress(0.0, f"Reaching {self.url}")
        limit = self.check().get("max_bytes")
        body = encode_request(segmented, locked, seed)
        if isinstance(limit, int) and len(body) > limit:
            raise BackendError(
                f"{segmented.name} takes {len(body) / 1e6:.0f} MB, the backend {self.url} "
                f"at most {limit / 1e6:.0f} MB; {_HERE}"
            )
        with closing(self._connection()) as connection:
            response = self._ask(connection, "POST", PREDICT_PATH, body, progress)
            data = self._follow(response, progress)
        progress(1.0, "Reading the answer")
        try:
            answer = decode_answer(data, segmented)
        except ArtiworldError as error:
            raise BackendError(f"the backend {self.url} can't be understood: {error}") from error
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
        """Send a request; its answer with status 200."""
        headers = {"Accept": "application/x-ndjson, application/json"}
        if self._token is not None:
            headers["Authorization"] = f"Bearer {self._token}"
        if body:
            headers |= {"Content-Type": CONTENT_TYPE, "Content-Length": str(len(body))}
        try:
            connection.connect()
            assert connection.sock is not None
            connection.sock.settimeout(self._silence_seconds)
            # It may answer before it has everything, as when too many wait.
            with suppress(BrokenPipeError, ConnectionResetError):
                connection.request(method, self._path + path, self._blocks(body, progress), headers)
            response = connection.getresponse()
        except TimeoutError as error:
            raise BackendError(self._away("it doesn't answer")) from error
        except ssl.SSLError as error:
            raise BackendError(self._away(f"no secure connection: {error.reason}")) from error
        except (OSError, http.client.HTTPException) as error:
            why = getattr(error, "strerror", None) or str(error) or type(error).__name__
            raise BackendError(self._away(why)) from error
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
        """Report progress line by line; what "done" holds."""
        while True:
            try:
                line = response.readline(_MAX_LINE)
                said = json.loads(line) if line.endswith(b"\n") else None
            except TimeoutError as error:
                raise BackendError(self._away("it has fallen silent")) from error
            except (OSError, http.client.HTTPException) as error:
                raise BackendError(self._away("it has gone away")) from error
            except (ValueError, RecursionError) as error:
                raise BackendError(f"the backend {self.url} can't be understood") from error
            if not isinstance(said, dict):
                raise BackendError(self._away("it broke off in the middle of the answer"))
            if "done" in said:
                return said["done"]
            if "error" in said:
                raise self._error(said)
            fraction, message = _progress_of(said)
            progress(0.05 + 0.95 * fraction, message)

    def _error(self, said: dict[str, Any]) -> Exception:
        text = str(said["error"])[:2000]
        if said.get("kind") == "user":
            return ArtiworldError(text)
        if said.get("kind") == "cancelled":
            return Cancelled(text)
        return BackendError(f"the backend {self.url} failed: {text}; {_HERE}")

    def _refusal(self, response: http.client.HTTPResponse) -> ArtiworldError:
        try:
            said = json.loads(response.read(_BLOCK))
            text = str(said["error"])[:2000]
        except (OSError, http.client.HTTPException, ValueError, KeyError, TypeError):
            return BackendError(
                f"{self.url} answered {response.status} {response.reason}: is it a backend?"
            )
        if response.status == 401:
            return BackendRefused(
                f"the backend {self.url} refuses the token; check --token or {TOKEN_VARIABLE}"
            )
        return BackendError(f"the backend {self.url} says: {text}")

    def _away(self, why: str) -> str:
        return f"the backend {self.url} can't be reached ({why}); {_HERE}"


def _progress_of(said: dict[str, Any]) -> tuple[float, str]:
    try:
        fraction, message = said["progress"]
        return min(max(float(fraction), 0.0), 1.0), str(message)[:200]
    except (KeyError, TypeError, ValueError):
        return 0.0, ""
