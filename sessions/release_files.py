"""Releases as folders: plain, as WebDataset shards, or in the layout of Hugging Face's hub.

All forms hold ``release.json``, ``README.md`` (the card) and ``manifest.sha256``, which
``sha256sum -c`` reads. The bytes depend on the assets and the options alone: no file says when it
was written. Nothing in a release of somebody else is trusted before its sums are checked.
"""

from __future__ import annotations

import io
import json
import re
import shutil
import tarfile
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path, PurePosixPath
from typing import Any, Final, NoReturn

from model.core.errors import ConfigurationError, InputFileError
from model.core.files import draft_of, file_sha256, read_json, written_to
from model.core.progress import Progress, no_progress, scaled_progress
from model.core.tables import escaped, table
from model.io.assets.reader import PROVENANCE, TREE, URDF, read_provenance
from sessions.project_settings import FORMS
from sessions.releases import (
    FORMAT,
    NAME,
    AcceptedAsset,
    Release,
    ReleasedAsset,
    described,
    files_of,
    json_bytes,
    keys_of,
    pseudonyms,
)
from sessions.store import ObjectRecord, Store

_SIZES: Final = ((1_000, "n<1K"), (10_000, "1K<n<10K"), (100_000, "10K<n<100K"))
"""Classes of size on Hugging Face's hub, by the number of rows."""
_USE: Final = {
    "folder": (
        "`assets/KEY/` is one asset: `object.urdf` with its meshes opens in any URDF reader.",
        "```python\nfrom model.io.assets.reader import load_object\n\n"
        'load_object("assets/KEY").tree.joints\n```',
    ),
    "webdataset": (
        "`shards/*.tar` are WebDataset shards. A sample has `json` (what stands in "
        "`release.json`), `urdf`, `tree.json` and `tar` (all files of the asset).",
        '```python\nimport webdataset\n\nwebdataset.WebDataset("shards/FILE.tar", '
        "shardshuffle=False)\n```",
    ),
    "huggingface": (
        "`metadata.jsonl` has a row for each asset; its column `urdf` leads to the file.",
        '```python\nfrom datasets import load_dataset\n\nload_dataset("json", '
        'data_files="metadata.jsonl")\n```',
    ),
}


def card(release: Release) -> str:
    """The card as Markdown; with a YAML header in the layout of Hugging Face."""
    assets = release.assets
    joints: Counter[str] = Counter()
    for asset in assets:
        joints.update(asset.joints)
    lines = [
        *(_header(release) if release.form == "huggingface" else ()),
        f"# {escaped(release.name)} {escaped(release.version)}",
        "",
        f"{len(assets)} articulated objects with {sum(joints.values())} moving joints, "
        f"{sum(a.bytes for a in assets) / 1e6:.1f} MB. The last one was accepted on "
        f"{release.newest or 'an unknown day'}. Metres, radians, +z up.",
        "",
        f"- Licence: {escaped(release.license) or 'none was given; ask before you use it'}",
        f"- Author: {escaped(release.author) or 'unknown'}",
        "",
    ]
    lines += _counts("Categories", "category", release.count("category"))
    lines += _counts("Joints", "type", joints)
    lines += _counts("Predictors", "predictor", release.count("predictor"))
    lines += _counts("Checks", "worst finding", release.count("validation"))
    lines += _agreement(release)
    about, code = _USE[release.form]
    lines += ["## Use", "", about, "", code, ""]
    lines += [
        "`sha256sum -c manifest.sha256` checks every file; `artiworld release import` does, too. "
        "People are numbered in `provenance.json`; their names aren't part of the release.",
    ]
    return "\n".join(lines) + "\n"


def _counts(title: str, column: str, counts: Counter[str]) -> list[str]:
    rows: Sequence[tuple[str, str]] = [
        (name, str(n)) for name, n in sorted(counts.items(), key=lambda i: (-i[1], i[0]))
    ]
    return [f"## {title}", "", *table((column, "count"), rows), ""]


def _agreement(release: Release) -> list[str]:
    figures: dict[str, Any] = dict(release.agreement)
    if not figures.get("pairs"):
        return ["## Agreement", "", "No object of it was annotated twice.", ""]
    rows = [(name.replace("_", " "), "–" if v is None else f"{v:g}") for name, v in figures.items()]
    return ["## Agreement", "", *table(("figure", "mean"), rows), ""]


def _header(release: Release) -> list[str]:
    """YAML; each value is written as JSON, which YAML reads."""
    count = len(release.assets)
    size = next((name for most, name in _SIZES if count < most), "100K<n<1M")
    said: dict[str, Any] = {
        "pretty_name": f"{release.name} {release.version}",
        **_license(release.license),
        "tags": ["3d", "articulated-objects", "urdf", "robotics"],
        "size_categories": [size],
        "configs": [{"config_name": "default", "data_files": "metadata.jsonl"}],
    }
    lines = [f"{k}: {json.dumps(v, ensure_ascii=False)}" for k, v in said.items()]
    return ["---", *lines, "---", ""]


def _license(name: str) -> dict[str, str]:
    """The hub knows licences by SPDX's names in small letters; others are "other"."""
    if not name:
        return {"license": "unknown"}
    known = name.lower()
    if known.startswith(("cc-", "cc0-")) or known in ("apache-2.0", "mit", "bsd-3-clause"):
        return {"license": known}
    return {"license": "other", "license_name": name}


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
    raise ConfigurationError(
        f"{out} is there already; a release never changes: give a new --version"
    )


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


UPLOADS: Final = "uploads"
"""Folder of a workspace whose objects are always in its queue."""
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_KEY = re.compile(r"[A-Za-z0-9_-]{1,128}")
_REMEDY = "get the release again from where it was published"
MOST_NAMED: Final = 3
"""Wrong files that an error names."""


def read_release(folder: Path) -> Release:
    """Content of ``release.json``; files aren't checked.

    Raises:
        InputFileError: where it is missing or damaged, or of a newer version.
    """
    path = folder / ABOUT
    said = read_json(path, "give the folder of a release")
    if not isinstance(said, dict) or not isinstance(said.get("format"), int):
        raise InputFileError(path, "is no release", "give the folder of a release")
    if said["format"] > FORMAT:
        raise InputFileError(
            path, f"has format {said['format']}, newer than {FORMAT}", "update ArtiWorld"
        )
    fields: dict[str, Any] = {k: v for k, v in said.items() if k not in ("format", "assets")}
    try:
        assets = tuple(ReleasedAsset(**a) for a in said["assets"])
        release = Release(**fields, assets=assets)
        texts = (release.name, release.version, *(a.key for a in assets))
        rules = (NAME, NAME, *(_KEY for _ in assets))
        wrong = [t for t, rule in zip(texts, rules, strict=True) if not rule.fullmatch(t)]
    except (KeyError, TypeError) as error:
        raise InputFileError(path, f"is damaged ({error})", _REMEDY) from None
    if wrong or release.form not in FORMS or len({a.key for a in assets}) < len(assets):
        odd = repr((wrong or [release.form])[0])[:80]
        raise InputFileError(path, f"names {odd}, which no release has", _REMEDY)
    return release


def check_release(folder: Path, progress: Progress = no_progress) -> None:
    """Check every file against ``manifest.sha256``.

    Raises:
        InputFileError: naming the files that are missing, changed, not in the manifest, links, or
            outside of the folder.
    """
    manifest = _manifest(folder / MANIFEST)
    wrong: list[str] = []
    for k, (name, sha256) in enumerate(manifest.items()):
        progress(k / len(manifest), name)
        path = folder / name
        if _is_link(folder, name):
            wrong.append(f"{name} is a link")
        elif not path.is_file():
            wrong.append(f"{name} is missing")
        elif file_sha256(path) != sha256:
            wrong.append(f"{name} has another sum")
    known = {*manifest, MANIFEST}
    for path in sorted(folder.rglob("*")):
        if not path.is_dir() or path.is_symlink():
            name = path.relative_to(folder).as_posix()
            wrong += [f"{name} isn't in {MANIFEST}"] * (name not in known)
    if wrong:
        named = ", ".join(wrong[:MOST_NAMED])
        rest = f" and {len(wrong) - MOST_NAMED} more" if len(wrong) > MOST_NAMED else ""
        raise InputFileError(folder, f"{named}{rest}", _REMEDY)


def _manifest(path: Path) -> dict[str, str]:
    """File → sum."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise InputFileError(path, f"can't be read ({error})", _REMEDY) from None
    out: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), 1):
        match = _LINE.fullmatch(line)
        if match is None or not is_inside(match[2]):
            what = "is no sum and name" if match is None else f"names {match[2][:80]!r}"
            raise InputFileError(path, f"line {number} {what}", "don't import this release")
        out[match[2]] = match[1]
    return out


def is_inside(name: str) -> bool:
    """True if a file's name leads to a place below its folder, on every system."""
    path = PurePosixPath(name)
    parts = name.split("/")
    return (
        bool(name)
        and not path.is_absolute()
        and all(p not in ("", ".", "..") for p in parts)
        and not any(c in name for c in "\\:\0")
        and name.isprintable()
    )


def _is_link(folder: Path, name: str) -> bool:
    path = folder / name
    return any(p.is_symlink() for p in (path, *path.parents) if p.is_relative_to(folder))


def import_release(
    folder: Path, store: Store, progress: Progress = no_progress
) -> list[ObjectRecord]:
    """Check a release and add its assets to a workspace, where they open with their joints.

    Raises:
        InputFileError: where a file is wrong, or the release is in the workspace already.
    """
    release = read_release(folder)
    check_release(folder, scaled_progress(progress, 0.0, 0.5))
    home = store.workspace / UPLOADS / f"{release.name}-{release.version}"
    if home.exists():
        _refuse_import(home)
    with written_to(home, "check space and permissions"), draft_of(home, _refuse_import) as draft:
        draft.mkdir()
        for k, (key, source) in enumerate(_assets(folder, release)):
            progress(0.5 + 0.5 * k / max(len(release.assets), 1), key)
            if isinstance(source, Path):
                shutil.copytree(source, draft / key, copy_function=shutil.copyfile)
            else:
                _unpack(source, draft / key)
        _check_assets(release, draft)
    return store.open_objects((home / a.key, None, a.key) for a in release.assets)


def _refuse_import(home: Path) -> NoReturn:
    raise InputFileError(home, "this release was imported before", "its objects are queued")


def _assets(folder: Path, release: Release) -> Iterator[tuple[str, Path | tarfile.TarFile]]:
    """Key → folder of an asset, or the tar that holds it."""
    if release.form != "webdataset":
        for asset in release.assets:
            yield asset.key, folder / ASSETS / asset.key
        return
    known = {a.key for a in release.assets}
    for shard in sorted((folder / SHARDS).glob("*.tar")):
        try:
            with tarfile.open(shard) as tar:
                for member in tar:
                    key, _, ending = member.name.partition(".")
                    if ending == "tar" and member.isfile() and key in known:
                        with tarfile.open(fileobj=tar.extractfile(member)) as packed:
                            yield key, packed
        except tarfile.TarError as error:
            raise InputFileError(shard, f"is no tar ({error})", _REMEDY) from None


def _unpack(tar: tarfile.TarFile, folder: Path) -> None:
    """Unpack plain files alone.

    Raises:
        InputFileError: for a link, a device, or a name that leads out of the folder.
    """
    for member in tar:
        if not member.isfile() or not is_inside(member.name):
            raise InputFileError(
                folder.name,
                f"holds {member.name[:80]!r}, which is no file of an asset",
                "don't import this release",
            )
        target = folder / member.name
        target.parent.mkdir(parents=True, exist_ok=True)
        content = tar.extractfile(member)
        assert content is not None
        with target.open("xb") as file:
            shutil.copyfileobj(content, file)


def _check_assets(release: Release, folder: Path) -> None:
    for asset in release.assets:
        for name in (URDF, PROVENANCE):
            if not (folder / asset.key / name).is_file():
                raise InputFileError(
                    Path(asset.key) / name, "isn't in the release, which lists it", _REMEDY
                )
