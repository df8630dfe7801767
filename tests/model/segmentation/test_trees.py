"""Trees in plain numpy answer as those that grew them."""

from pathlib import Path

import numpy as np
import pytest

from model.core.errors import InputFileError
from model.segmentation.models import Mlp, Trees, load_scorer, load_trees, save_mlp, save_trees
from model.training.segmentation.rows import Boosting, fit_mlp, fit_trees, plain_trees

NAMES = ("size", "border", "depth")


def grown(seed: int = 0) -> tuple[Trees, np.ndarray, np.ndarray, np.ndarray]:
    """Trees, and the hypotheses of 200 clicks, twelve each, that they learned from."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(2400, 3)).astype(np.float32)
    value = 1 / (1 + np.exp(-(2 * x[:, 0] - x[:, 1] ** 2)))
    click = np.repeat(np.arange(200), 12)
    config = Boosting(trees=60, leaves=8, least=10)
    return fit_trees(NAMES, x, value, click, np.ones(200), config), x, value, click


def test_the_best_of_each_click_comes_first() -> None:
    trees, *_ = grown()
    rng = np.random.default_rng(1)
    x = rng.normal(size=(100, 12, 3)).astype(np.float32)
    value = 1 / (1 + np.exp(-(2 * x[..., 0] - x[..., 1] ** 2)))
    score = trees(x.reshape(-1, 3)).reshape(100, 12)
    chosen = np.take_along_axis(value, score.argmax(1)[:, None], 1)
    assert chosen.mean() > value.max(1).mean() - 0.03
    assert chosen.mean() > value.mean() + 0.3


def test_answers_are_those_of_the_library_that_grew_them() -> None:
    lightgbm = pytest.importorskip("lightgbm")
    _, x, value, click = grown()
    data = lightgbm.Dataset(x, (31 * value).astype(int), group=np.bincount(click))
    model = lightgbm.train(
        {"objective": "lambdarank", "label_gain": list(range(32)), "verbosity": -1}, data, 40
    )
    trees = plain_trees(NAMES, model.dump_model()["tree_info"])
    # Inputs on the very thresholds go to the same side, too.
    on = np.sort(trees.threshold[np.isfinite(trees.threshold)])
    edge = np.stack([on, on, on], axis=1)
    asked = np.concatenate([x, edge, np.nextafter(edge, np.float32(np.inf))]).astype(np.float32)
    assert np.allclose(trees(asked), model.predict(asked), atol=1e-5)


def test_they_are_the_same_after_reading_and_pick_their_own_columns(tmp_path: Path) -> None:
    trees, x, *_ = grown()
    path = tmp_path / "trees.npz"
    save_trees(trees, path, {"training": {}})
    assert np.array_equal(load_trees(path, NAMES)(x), trees(x))
    wider = np.concatenate([x[:, ::-1], np.full((len(x), 1), np.nan, np.float32)], axis=1)
    read = load_scorer(path, (*reversed(NAMES), "more"))
    assert isinstance(read, Trees)
    assert np.array_equal(read(wider), trees(x))
    assert np.array_equal(grown()[0](x), trees(x)), "grown again they are the same"


def test_a_file_says_what_it_holds(tmp_path: Path) -> None:
    trees, x, value, _ = grown()
    path = tmp_path / "scorer.npz"
    save_mlp(fit_mlp(NAMES, x, value, np.ones(len(x)), epochs=1), path, {})
    assert isinstance(load_scorer(path, NAMES), Mlp)
    save_trees(trees, path, {})
    assert isinstance(load_scorer(path, NAMES), Trees)
    with pytest.raises(InputFileError, match="other features"):
        load_scorer(path, ("size", "border"))
    with pytest.raises(InputFileError, match="not there"):
        load_scorer(tmp_path / "none.npz", NAMES)
