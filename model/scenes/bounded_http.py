"""An HTTP client for servers of strangers: answers of limited size and time, no redirects."""

from __future__ import annotations

import time
from typing import Any

from model.core.packages import require

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
