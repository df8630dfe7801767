"""Reading a release of somebody else: nothing in it is trusted before its sums are checked."""

from __future__ import annotations

import re
import shutil
import tarfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath
from typing import Any, Final, NoReturn

from model.core.errors import InputFileError
from model.core.files import draft_of, file_sha256, read_json, written_to
from model.core.progress import Progress, no_progress, scaled_progress
from model.io.assets.reader import PROVENANCE, URDF
from sessions.releases.contents import FORMAT, NAME, Release, ReleasedAsset
from sessions.releases.forms import FORMS
from sessions.releases.writing import ABOUT, ASSETS, MANIFEST, SHARDS
from sessions.store import ObjectRecord, Store

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
        raise InputFileError(path, f"has format {said['format']}, newer than {FORMAT}",
                             "update ArtiWorld")  # fmt: skip
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
        bool(name) and not path.is_absolute() and all(p not in ("", ".", "..") for p in parts)
        and not any(c in name for c in '\\:\0') and name.isprintable()
    )  # fmt: skip


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
        _refuse(home)
    with written_to(home, "check space and permissions"), draft_of(home, _refuse) as draft:
        draft.mkdir()
        for k, (key, source) in enumerate(_assets(folder, release)):
            progress(0.5 + 0.5 * k / max(len(release.assets), 1), key)
            if isinstance(source, Path):
                shutil.copytree(source, draft / key, copy_function=shutil.copyfile)
            else:
                _unpack(source, draft / key)
        _check_assets(release, draft)
    return store.open_objects((home / a.key, None, a.key) for a in release.assets)


def _refuse(home: Path) -> NoReturn:
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
                folder.name, f"holds {member.name[:80]!r}, which is no file of an asset",
                "don't import this release",
            )  # fmt: skip
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
