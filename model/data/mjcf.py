"""MJCF files as a data set, read as the app opens them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from model.core.errors import InputFileError
from model.data.protocol import GroundTruth
from model.io.merging import merge_rigid
from model.io.mjcf_reader import need_mujoco, read_mjcf_model
from model.io.urdf.meshes import load_part


@dataclass(frozen=True)
class MjcfFolder:
    """``<id>.xml`` or ``<id>/*.xml`` that MuJoCo can load."""

    root: Path
    name: str = "mjcf"

    def ids(self) -> tuple[str, ...]:
        """Names of files and sub-folders, sorted; files that others include are among them.

        Raises:
            InputFileError: where there is none.
            ConfigurationError: where MuJoCo isn't installed.
        """
        need_mujoco()
        found = self._files()
        if not found:
            raise InputFileError(
                self.root, "no MJCF in it", "give a folder of <id>.xml or <id>/<any>.xml"
            )
        return tuple(sorted(found))

    def _files(self) -> dict[str, Path]:
        root = Path(self.root)
        out = {p.stem: p for p in sorted(root.glob("*.xml"))}
        for folder in sorted(p for p in root.iterdir() if p.is_dir()) if root.is_dir() else ():
            here = sorted(folder.glob("*.xml"))
            if here and folder.name not in out:
                named = [p for p in here if p.stem in (folder.name, "object")]
                out[folder.name] = (named or here)[0]
        return out

    def category(self, object_id: str) -> str | None:
        """MJCF doesn't say."""
        return None

    def load(self, object_id: str) -> GroundTruth:
        """Read one object.

        Raises:
            InputFileError: where MuJoCo can't load it, or nothing in it can be seen.
        """
        path = self._files().get(object_id)
        if path is None:
            raise InputFileError(Path(self.root) / object_id, "no MJCF there")
        return read_mjcf(path, object_id, Path(self.root))


def read_mjcf(path: Path, name: str | None = None, root: Path | None = None) -> GroundTruth:
    """Read one MJCF file; see ``read_mjcf_model``.

    Args:
        path: the file.
        name: of the object; by default the file's.
        root: the folder that references must not leave; by default the file's own.

    Raises:
        InputFileError: where MuJoCo can't load it, or nothing in it can be seen.
    """
    model = read_mjcf_model(path, root=root)
    parts = {link: load_part(link, visuals) for link, visuals in model.by_link.items()}
    object_id = name or path.stem
    obj, merges = merge_rigid(object_id, model.tree, parts)
    return GroundTruth(object_id, obj, (*model.notes, *merges))
