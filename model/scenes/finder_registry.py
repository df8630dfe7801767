"""All finders of articulable objects by name: built-ins and plug-ins load the same way."""

from __future__ import annotations

import os
from pathlib import Path

from model.core.packages import Registry
from model.core.progress import Progress, no_progress
from model.scenes.finder_options import FinderOptions
from model.scenes.protocol import ArticulableFinder

DEFAULT = "lexicon"

FINDERS = Registry[ArticulableFinder](
    "finder",
    ArticulableFinder,
    "name and find",
    {DEFAULT: "model.scenes.finders:LexiconFinder"},
    group="artiworld.articulable_finders",
    parametrised={
        "openai": "model.scenes.openai_engine:openai_finder",
        "qwen3": "model.scenes.qwen_engine:qwen_finder",
    },
    argument="MODEL",
)


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
    if ":" in name:
        return FINDERS.load(name, options or FinderOptions(), progress)
    return FINDERS.load(name)
