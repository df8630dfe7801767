"""Files that declare parts and joints: URDF, SDF, MJCF and USD, read into the same model."""

from __future__ import annotations

from pathlib import Path

from model.core.errors import InputFileError
from model.io.formats.loaded import DEFAULT_MAX_BYTES
from model.io.formats.usd import USD_SUFFIXES
from model.io.mjcf.reader import read_mjcf_model
from model.io.mjcf.source import MJCF_SUFFIXES, is_mjcf, named_files
from model.io.urdf.anymesh import is_anymesh
from model.io.urdf.files import URDF_SUFFIX, is_urdf, named_meshes
from model.io.urdf.model import UrdfModel
from model.io.urdf.reader import read_urdf_model
from model.io.urdf.sdf import SDF_SUFFIX, is_sdf
from model.io.usd_model import read_usd_model

MODEL_SUFFIXES = (URDF_SUFFIX, *MJCF_SUFFIXES, SDF_SUFFIX)


def is_model(path: Path) -> bool:
    """True if ``path`` is a URDF, an XML file that begins as an MJCF does, an SDF of one model, or
    AnyMesh's JSON."""
    return is_urdf(path) or is_mjcf(path) or is_sdf(path) or is_anymesh(path)


def articulated_stage(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> UrdfModel | None:
    """Articulated object of a USD stage; None for any other file.

    Raises:
        InputFileError: where it is a damaged stage.
        ConfigurationError: where usd-core isn't installed.
    """
    return read_usd_model(path, max_bytes) if path.suffix.lower() in USD_SUFFIXES else None


def read_model(path: Path, max_bytes: int = DEFAULT_MAX_BYTES) -> UrdfModel:
    """Read a file without loading meshes, which a USD stage holds itself; see
    ``read_urdf_model``, ``read_mjcf_model`` and ``read_usd_model``.

    Args:
        path: the file.
        max_bytes: refuse larger meshes where they are read at once.

    Raises:
        InputFileError: naming the file and what is wrong in it.
        ConfigurationError: for an MJCF or USD, where MuJoCo or usd-core isn't installed.
    """
    if path.suffix.lower() in MJCF_SUFFIXES:
        return read_mjcf_model(path, max_bytes=max_bytes)
    if path.suffix.lower() in USD_SUFFIXES:
        model = articulated_stage(path, max_bytes)
        if model is None:
            raise InputFileError(
                path, "holds no object with joints, or several", "open it as a scene or a mesh"
            )
        return model
    return read_urdf_model(path)


def files_named_by(path: Path) -> list[Path]:
    """Absolute paths that the model's files may have; only its own text is read."""
    return named_meshes(path) if is_urdf(path) or is_sdf(path) else named_files(path)
