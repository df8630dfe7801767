"""A complete plug-in, as short as possible: a ball around each click.

To plug in your own network, write the two classes below in your package, import the network's
libraries inside ``encode`` (so that nothing is loaded before it is needed), and name the segmenter
in your package's ``pyproject.toml``::

    [project.entry-points."artiworld.segmenters"]
    balls = "your_package:BallSegmenter"

``artiworld serve --segmenter balls`` then answers clicks with it, in the worker process, and
``artiworld bench segment --segmenter balls`` measures it. The contract of segmenters is
:mod:`model.segmentation.registry`; ``tests/model/segmentation/test_contract.py`` checks it. Two
functions do the hard part: :func:`~model.segmentation.prompt_steps.resolve` ties prompts to
elements, :func:`~model.segmentation.prompt_steps.enforce` makes labels agree with them exactly.
"""

from __future__ import annotations

import time

import numpy as np
import numpy.typing as npt

from model.core.asset import Asset
from model.core.progress import Progress, no_progress
from model.segmentation.nodes import nodes_of_asset
from model.segmentation.prompt_steps import ClickStep, enforce, resolve
from model.segmentation.prompts import BASE, PartSegmentation, Prompts

RADIUS = 0.1
"""Radius of a ball, in diagonals of the bounding box."""


class BallSession:
    """An asset made ready once: here only its nodes, for a network its features."""

    def __init__(self, asset: Asset) -> None:
        self.asset = asset
        self._nodes = nodes_of_asset(asset)  # at most 100,000 points, also for meshes

    def segment(self, prompts: Prompts) -> PartSegmentation:
        """Labels for all elements; see the protocol."""
        begin = time.perf_counter()
        steps = resolve(self.asset, self._nodes, prompts)
        of_node = np.zeros(len(self._nodes), np.int16)
        for step in steps:
            if isinstance(step, ClickStep) and step.positive:
                away = np.linalg.norm(self._nodes.points - self._nodes.points[step.node], axis=1)
                of_node[away < RADIUS * self.asset.diagonal] = step.part
        labels = self._nodes.elements.to_elements(of_node)
        instead = np.full(self.asset.element_count, BASE, np.int16)
        labels = enforce(labels, steps, instead)
        return PartSegmentation(labels, "balls", time.perf_counter() - begin)

    def candidates(self, prompts: Prompts, part: int) -> list[npt.NDArray[np.bool_]]:
        """Other masks for ``part``: none."""
        return []


class BallSegmenter:
    """See :class:`~model.segmentation.registry.Segmenter`."""

    name = "balls"

    def encode(self, asset: Asset, progress: Progress = no_progress) -> BallSession:
        """See :class:`~model.segmentation.registry.Segmenter`."""
        progress(0.0, "sampling")
        return BallSession(asset)
