"""Options of the finders that ask a language model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path


@dataclass(frozen=True)
class FinderOptions:
    """For finders that ask a language model.

    Attributes:
        url: of the server, None for its environment variable or OpenAI's.
        batch: objects a question.
        timeout: seconds without an answer.
        retries: after the first try.
        cache: folder of answers; None keeps none.
        asks: whether it will be asked at all: one whose questions are only counted needs no key.
    """

    url: str | None = None
    batch: int = 20
    timeout: float = 120.0
    retries: int = 5
    cache: Path | None = None
    asks: bool = True
