"""Releases as folders: plain, as WebDataset shards, or in the layout of Hugging Face's hub.

All forms hold ``release.json``, ``README.md`` (the card) and ``manifest.sha256``, which
``sha256sum -c`` reads. The bytes depend on the assets and the options alone: no file says when it
was written.
"""

from __future__ import annotations

import io
import json
import shutil
import tarfile
from collections.abc import Iterator, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import Final, NoReturn

from model.core.errors import ConfigurationError, InputFileError
from model.core.files import draft_of, file_sha256, written_to
from model.core.progress import Progress, no_progress
from model.io.assets.reader import TREE, URDF, read_provenance
from sessions.releases.card import card
from sessions.releases.contents import (
    AcceptedAsset,
    Release,
    ReleasedAsset,
    described,
    files_of,
    json_bytes,
    keys_of,
    pseudonyms,
)

ASSETS, SHARDS, ROWS = "assets", "shards", "metadata.jsonl"
ABOUT, MANIFEST, CARD = "release.json", "manifest.sha256", "README.md"
NOT_FOR_OTHERS: Final = 0o444
"""Released files are read-only: a release is frozen."""

Files = Mapping[str, Path | bytes]


def write_release(
    release: Release,
    assets: list[AcceptedAsset],
    out: Path,
    *,
    shard_bytes: int = 500_000_000,
    progress: Progress = no_progress,
) -> Release:
    """Write a release into the new folder ``out``; returns it with its assets.

    Args:
        release: all but its assets.
        assets: that it is to hold.
        shard_bytes: a WebDataset shard is closed before it grows beyond that.

    Raises:
        ConfigurationError: where ``out`` is there already, or there are no assets.
        InputFileError: where an asset was changed since it was accepted, or ``out`` can't be
            written.
    """
    if out.exists():
        _refuse(out)
    if not assets:
        raise ConfigurationError("no object is accepted; accept some first")
    with written_to(out, "check space and permissions"), draft_of(out, _refuse) as draft:
        draft.mkdir()
        return _write(release, assets, draft, shard_bytes, progress)


def _refuse(out: Path) -> NoReturn:
    raise ConfigurationError(f"{out} is there already; a release never changes: give a new "
                             "--version")  # fmt: skip


def _write(
    release: Release,
    assets: list[AcceptedAsset],
    folder: Path,
    shard_bytes: int,
    progress: Progress,
) -> Release:
    keys = keys_of(assets)
    people = pseudonyms(read_provenance(a.folder) for a in assets)
    shards = _Shards(folder / SHARDS, f"{release.name}-{release.version}", shard_bytes)
    rows: list[ReleasedAsset] = []
    for k, (key, asset) in enumerate(keys.items()):
        progress(k / len(keys), asset.name)
        files = files_of(asset, people)
        rows.append(described(key, asset, files))
        if release.form == "webdataset":
            shards.add(rows[-1], files)
        else:
            _copy(files, folder / ASSETS / key)
    shards.close()
    found = replace(release, assets=tuple(rows))
    (folder / ABOUT).write_bytes(json_bytes(found.to_json()))
    (folder / CARD).write_text(card(found), encoding="utf-8")
    if release.form == "huggingface":
        (folder / ROWS).write_bytes(b"".join(map(_row, rows)))
    written = sorted(p for p in folder.rglob("*") if p.is_file())
    lines = [f"{file_sha256(p)}  {p.relative_to(folder).as_posix()}\n" for p in written]
    (folder / MANIFEST).write_text("".join(lines), encoding="utf-8")
    for path in (*written, folder / MANIFEST):
        path.chmod(NOT_FOR_OTHERS)
    return found


def _row(asset: ReleasedAsset) -> bytes:
    """A line of ``metadata.jsonl``: the same columns in all lines, joints as text."""
    row = asdict(asset) | {
        "joints": json.dumps(asset.joints),
        "folder": f"{ASSETS}/{asset.key}",
        "urdf": f"{ASSETS}/{asset.key}/{URDF}",
    }
    return (json.dumps(row, ensure_ascii=False) + "\n").encode("utf-8", "backslashreplace")


def _copy(files: Files, folder: Path) -> None:
    for name, content in files.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            target.write_bytes(content)
        else:
            shutil.copyfile(content, target)


class _Shards:
    """Numbered tars; a sample is ``key.json``, ``key.urdf``, ``key.tree.json`` and ``key.tar``,
    which holds all files of the asset."""

    def __init__(self, folder: Path, name: str, most_bytes: int) -> None:
        self._folder, self._name, self._most = folder, name.replace(".", "_"), most_bytes
        self._tar: tarfile.TarFile | None = None
        self._size = self._count = 0

    def add(self, asset: ReleasedAsset, files: Files) -> None:
        """Append a sample."""
        if self._tar is None or (self._size and self._size + asset.bytes > self._most):
            self.close()
            self._folder.mkdir(exist_ok=True)
            path = self._folder / f"{self._name}-{self._count:06}.tar"
            self._tar = tarfile.TarFile(path, "w", format=tarfile.PAX_FORMAT)
            self._count, self._size = self._count + 1, 0
        for ending, content in _sample(asset, files):
            _add(self._tar, f"{asset.key}.{ending}", content)
        self._size += asset.bytes

    def close(self) -> None:
        """End the last shard."""
        if self._tar is not None:
            self._tar.close()


def _sample(asset: ReleasedAsset, files: Files) -> Iterator[tuple[str, bytes]]:
    packed = io.BytesIO()
    with tarfile.open(fileobj=packed, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name, content in files.items():
            _add(tar, name, _bytes(content))
    yield "json", json_bytes(asdict(asset))
    for ending, name in (("urdf", URDF), ("tree.json", TREE)):
        yield ending, _bytes(files[name])
    yield "tar", packed.getvalue()


def _bytes(content: Path | bytes) -> bytes:
    return content if isinstance(content, bytes) else content.read_bytes()


def _add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    """Add a file without time and owner, which would differ from run to run."""
    about = tarfile.TarInfo(name)
    about.size = len(content)
    tar.addfile(about, io.BytesIO(content))


def next_version(folder: Path, name: str) -> str:
    """The number after the highest of the releases of that name in ``folder``: "1" for the first.

    Raises:
        InputFileError: where the folder can't be read.
    """
    try:
        found = [p.name.removeprefix(f"{name}-") for p in folder.glob(f"{name}-*")]
    except OSError as error:
        raise InputFileError(folder, error.strerror or "can't be read") from None
    numbers = [int(n.partition(".")[0]) for n in found if n.partition(".")[0].isdecimal()]
    return str(max(numbers, default=0) + 1)
