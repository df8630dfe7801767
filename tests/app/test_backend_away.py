"""The app with a backend that isn't there: it says so, and predicts here where asked to."""

from __future__ import annotations

import pytest

from app.server.app_state import AppState
from app.server.config import ServeConfig
from sessions.store import Store
from tests.app.run_cli import cupboard
from tests.builders import wait_until


@pytest.fixture
def app_state(tmp_path):
    parts = tmp_path / "cupboard"
    parts.mkdir()
    for i, mesh in enumerate(cupboard()):
        mesh.export(parts / f"link_{i}.obj")
    workspace = tmp_path / "workspace"
    config = ServeConfig((parts,), workspace, segmenter="nearest", predictor="http://127.0.0.1:9")
    made = AppState(config, Store(workspace), [parts])
    yield made
    made.close()


def test_a_backend_that_is_away_is_told_and_this_machine_predicts(app_state):
    obj = app_state.object(app_state.queue.records()[0].id)
    told: list[tuple[str, str, str]] = []
    obj.watch(lambda: None, lambda *news: told.append(news))
    wait_until(lambda: obj.document.segmentation is not None and obj.document.segmentation_current)
    assert not obj.backend_away
    obj.predict("ada")
    wait_until(lambda: "predict" not in obj.jobs)
    assert obj.backend_away and obj.document.tree is None
    text = " ".join(f"{title} {body}" for title, body, _ in told)
    assert "can't be reached" in text and "Predict on this machine" in text
    obj.predict("ada", here=True)
    wait_until(lambda: obj.document.tree is not None)
    prediction = obj.document.prediction
    assert prediction is not None and "http" not in prediction.backend
