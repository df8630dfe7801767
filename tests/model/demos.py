"""The bundled demo objects with their ground truth."""

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np

from model.core.articulated_object import ArticulatedObject
from model.core.files import static_assets
from model.data.folders import Bundled
from model.io.open_asset import open_asset
from model.segmentation.default import DefaultSegmenter, DefaultSession

EXAMPLES = static_assets() / "examples"
DEMOS = tuple(sorted(p.stem for p in (EXAMPLES / "truth").glob("*.json")))


def demo_file(name: str) -> Path:
    return next(p for p in EXAMPLES.glob(f"{name}.*") if p.suffix in (".glb", ".ply"))


def demo_truth(name: str) -> tuple[np.ndarray, dict[str, Any]]:
    """The true part of each element, and what else is known of the parts."""
    truth = json.loads((EXAMPLES / "truth" / f"{name}.json").read_text())
    runs = truth["runs"]
    return np.repeat([part for part, _ in runs], [count for _, count in runs]), truth


@functools.lru_cache(maxsize=4)
def encoded_demo(name: str) -> DefaultSession:
    """A demo, encoded once for all tests; its answers depend on the prompts alone."""
    return DefaultSegmenter().encode(open_asset(demo_file(name)))


def demo_object(name: str) -> ArticulatedObject:
    """A demo cut by its true labels, with its true joints."""
    return Bundled().load(name).object
