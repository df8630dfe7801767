"""All finders of articulable objects by name: built-ins and plug-ins load the same way."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.metadata import entry_points
from pathlib import Path

from model.core.errors import ConfigurationError
from model.core.plug_ins import load_plug_in
from model.core.progress import Progress, no_progress
from model.scenes.finders import LexiconFinder
from model.scenes.protocol import ArticulableFinder

ENTRY_POINTS = "artiworld.articulable_finders"
"""Entry-point group of plug-ins; each names a callable without arguments that gives a finder."""
DEFAULT = "lexicon"
KNOWN = "lexicon, openai:MODEL, qwen3:FOLDER"


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


def default_cache() -> Path:
    """The user's cache folder, by the XDG base directory specification."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "artiworld" / "finder"


def load_finder(
    name: str = DEFAULT, options: FinderOptions | None = None, progress: Progress = no_progress
) -> ArticulableFinder:
    """The finder called ``name``: ``lexicon``, ``openai:MODEL``, ``qwen3:FOLDER``, or a plug-in's.

    Raises:
        ConfigurationError: where there is none, or it lacks a package or a key.
    """
    options = options or FinderOptions()
    kind, colon, what = name.partition(":")
    if name == DEFAULT:
        return LexiconFinder()
    if colon and what and kind in ("openai", "qwen3"):
        from model.scenes.language_finder import LanguageFinder
        from model.scenes.openai_engine import OpenAiEngine
        from model.scenes.qwen_engine import QwenEngine

        if kind == "qwen3":
            return LanguageFinder(QwenEngine(Path(what)), options.cache, progress=progress)
        engine = OpenAiEngine(
            what, options.url, batch=options.batch, timeout=options.timeout,
            retries=options.retries, asks=options.asks,
        )  # fmt: skip
        return LanguageFinder(engine, options.cache, progress=progress)
    plugins = {p.name: p for p in entry_points(group=ENTRY_POINTS)}
    if name not in plugins:
        raise ConfigurationError(
            f"no finder {name!r}; there are {', '.join([KNOWN, *plugins])}"
        )  # fmt: skip
    return load_plug_in(plugins[name], "finder", ArticulableFinder, "name and find")
