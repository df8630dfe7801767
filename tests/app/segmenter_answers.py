"""What the segmenter says of an object that stands in for an open one."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import Mock

import numpy as np

from app.server.segmenting import Segmenting
from app.server.segmenting_tasks import SegmentationAnswer
from sessions.document import Document


def answer(segmenting: Segmenting, obj: Any, document: Document, labels: np.ndarray) -> None:
    """Let ``obj`` have new prompts, for which the segmenter finds these labels to display."""
    counts = dict(enumerate(np.bincount(labels[labels >= 0]).tolist()))
    found = SegmentationAnswer(document.key, "a" * 64, labels, counts, "default", 0.0)
    submit = Mock(return_value=found)
    obj.document, obj.state = document, SimpleNamespace(present=document)
    obj.record, obj.jobs = SimpleNamespace(id=1), Mock()
    obj.lane = SimpleNamespace(segmentation=SimpleNamespace(submit=submit))
    config = SimpleNamespace(segmenter="default")
    obj.services = SimpleNamespace(workspace=Path(), config=config)
    obj.start = lambda kind, job, keep: keep(job)
    segmenting.update()
    submit.assert_called_once()
