"""Pickles given as weights, shards or scans are never unpickled."""

import os
import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from model.core.errors import ArtiworldError
from model.io.open_asset import open_asset
from model.prediction.arti4urdf.network import load_weights
from model.segmentation.adapters.point_sam import load_network
from model.segmentation.models import load_mlp
from model.training.arti4urdf.samples import read_shard


class Hostile:
    """Makes a folder where it is unpickled."""

    def __init__(self, mark: Path) -> None:
        self.mark = str(mark)

    def __reduce__(self):
        return os.mkdir, (self.mark,)


def as_pickle(path: Path, content: object) -> None:
    path.write_bytes(pickle.dumps(content))


def as_npy(path: Path, content: object) -> None:
    with path.open("wb") as file:
        np.save(file, np.array([content], object), allow_pickle=True)


def as_npz(path: Path, content: object) -> None:
    with path.open("wb") as file:
        np.savez(file, points=np.array([content], object), allow_pickle=True)  # type: ignore[arg-type]


def as_torch(path: Path, content: object) -> None:
    torch = pytest.importorskip("torch")
    torch.save({"state_dict": {"a": content}}, path)


def shipped_with(path: Path) -> object:
    """The folder of weights that ``path`` lies in."""
    (path.parent / "config.json").write_text('{"format": 1}')
    return load_weights(path.parent)


LOADERS: dict[str, Callable[[Path], object]] = {
    "a.npz": open_asset,
    "model.pth": lambda path: load_network(path, "cpu"),
    "model.safetensors": shipped_with,
    "mlp.npz": lambda path: load_mlp(path, ("a",)),
    "shard.npz": read_shard,
}


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
@pytest.mark.parametrize("write", [as_pickle, as_npy, as_npz, as_torch])
@pytest.mark.parametrize("name", LOADERS)
def test_a_pickle_is_never_unpickled(
    name: str, write: Callable[[Path, object], None], tmp_path: Path
) -> None:
    mark = tmp_path / "executed"
    write(tmp_path / name, Hostile(mark))
    with pytest.raises((ArtiworldError, ValueError, KeyError)):
        LOADERS[name](tmp_path / name)
    assert not mark.exists()


def test_the_hostile_pickle_would_do_it(tmp_path: Path) -> None:
    as_pickle(tmp_path / "a", Hostile(tmp_path / "executed"))
    pickle.loads((tmp_path / "a").read_bytes())
    assert (tmp_path / "executed").is_dir()
