"""The same clicks give the same masks on every processor."""

from __future__ import annotations

import hashlib
import json
import os
import platform
import subprocess
import sys

import numpy as np
import pytest

from model.core.asset import Asset
from model.segmentation.default import DefaultSegmenter
from model.segmentation.prompts import Click, Prompts
from model.segmentation.proposals import Proposals
from model.segmentation.solver import ScoredProposals
from tests.model.segmentation.test_fronts import flush_fronts

OTHER = {
    "OPENBLAS_CORETYPE": "Prescott",
    "NPY_DISABLE_CPU_FEATURES": "X86_V3 X86_V4 AVX512_ICL AVX512_SPR",
}


ROUNDED = 1e-5
"""Log-odds by which scores may differ: below what decides between two masks."""


def answers() -> tuple[list[float], list[str]]:
    """Scores of a click's masks; digests of edge strengths, superpoints, three clicks' masks."""
    cloud, _ = flush_fronts(10_000)
    session = DefaultSegmenter().encode(Asset("panels", cloud=cloud))
    found = [session.encoding.strength, session.encoding.superpoints.of_node]
    first = session.solver.first_answer(int(session.encoding.superpoints.of_node[1000]))
    found += [first.proposals.masks, first.order]
    clicks = (Click((1.0, 0, 0.2), 1), Click((0.62, 0, 0.1), 1), Click((0.4, 0, 0.7), 2))
    for count in (1, 2, 3):
        prompts = Prompts(clicks[:count])
        found += [session.segment(prompts).labels, *session.candidates(prompts, 1)]
    digests = [hashlib.sha256(np.ascontiguousarray(v).tobytes()).hexdigest() for v in found]
    return first.scores.tolist(), digests


@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="names kernels of x86")
def test_a_click_means_the_same_mask_on_another_processor() -> None:
    code = f"import json; from {__name__} import answers; print(json.dumps(answers()))"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **OTHER}, capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    scores, digests = json.loads(done.stdout)
    own_scores, own_digests = answers()
    assert scores == pytest.approx(own_scores, abs=ROUNDED)
    assert digests == own_digests


def test_of_equal_scores_the_larger_mask_counts_then_the_first() -> None:
    masks = np.arange(4) < np.array([[1], [2], [3], [3], [4]])
    residues = np.array([2e-9, 0.0, -2e-9, 1e-9, 0.0])
    for sign in (1, -1):
        scores = np.array([3.0, 3.0, 3.0, 3.0, 2.0]) + sign * residues
        scored = ScoredProposals(Proposals.of(masks, "keep"), np.zeros((5, 1)), scores)
        assert scored.order.tolist() == [2, 3, 1, 0, 4]
        assert scored.best.sum() == 3
