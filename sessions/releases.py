"""Data sets for other people: frozen, numbered, checksummed sets of accepted assets.

A release holds accepted assets as they were saved, without names of people and paths. Two releases
are compared by their contents.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections import Counter
from collections.abc import Container, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path, PurePath
from typing import Any, Final

from model.core.errors import ConfigurationError, InputFileError
from model.core.files import file_sha256, free_name, read_json
from model.io.assets.reader import PROVENANCE, TREE, read_provenance
from sessions.store import Store

FORMAT: Final = 1
"""Format of ``release.json``."""
NAME: Final = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")
"""Names and versions that a release may have: they become names of folders and files."""
_PEOPLE = ("who", "by")
_PATHS = ("path", "scene", "file")


@dataclass(frozen=True)
class ReleasedAsset:
    """One asset of a release.

    Attributes:
        key: its name in the release, without dots.
        name, category: of the object; category "" for none.
        predictor: who predicted its joints, with version; "" where nobody did.
        source, source_sha256: name of the file it was made of, and that file's sum, or "".
        accepted: when, ISO 8601, UTC.
        validation: verdict of the checks, "" where they didn't run.
        parts: how many. joints: type → how many, of those that move.
        bytes: of all its files.
        digest: SHA-256 over names and sums of its files.
    """

    key: str
    name: str
    category: str = ""
    predictor: str = ""
    source: str = ""
    source_sha256: str = ""
    accepted: str = ""
    validation: str = ""
    parts: int = 0
    joints: Mapping[str, int] = field(default_factory=dict)
    bytes: int = 0
    digest: str = ""


@dataclass(frozen=True)
class Release:
    """A release, as ``release.json`` has it.

    Attributes:
        name, version: of the release.
        form: folder, webdataset or huggingface.
        license, author: of the assets; "" where unknown.
        agreement: figures of :mod:`sessions.quality`, {} where nothing was annotated twice.
        assets: in the order of their keys.
    """

    name: str
    version: str
    form: str
    license: str = ""
    author: str = ""
    agreement: Mapping[str, Any] = field(default_factory=dict)
    assets: tuple[ReleasedAsset, ...] = ()

    @property
    def newest(self) -> str:
        """Day of the last acceptance, "" without assets."""
        return max((a.accepted[:10] for a in self.assets), default="")

    def count(self, attribute: str) -> Counter[str]:
        """Number of assets with each value of an attribute."""
        return Counter(getattr(a, attribute) or "unknown" for a in self.assets)

    def to_json(self) -> dict[str, Any]:
        """Plain values."""
        return {"format": FORMAT, **asdict(self), "assets": [asdict(a) for a in self.assets]}


@dataclass(frozen=True)
class AcceptedAsset:
    """An accepted asset in its workspace, and the name of its object."""

    folder: Path
    name: str


def check_name(text: str, option: str) -> str:
    """The name or version of a release.

    Raises:
        ConfigurationError: where it can't be the name of a folder everywhere.
    """
    if not NAME.fullmatch(text):
        raise ConfigurationError(
            f"{option} {text[:80]!r} must be of letters, digits, “.”, “_” and “-”, such as 1.0"
        )
    return text


def accepted_assets(
    store: Store, without: Container[int] = (), broken: list[str] | None = None
) -> list[AcceptedAsset]:
    """The saved assets of all objects that are accepted now, in the order of the queue.

    Args:
        without: ids of objects that are left out, such as second annotations of others.
        broken: gets the names of those that can't be had; None where none may be missing.

    Raises:
        InputFileError: where the folder of one is gone.
    """
    found = []
    for record in store.objects():
        if record.state != "accepted" or record.id in without:
            continue
        folder = saved_folder(store, record.id)
        if folder is not None and folder.is_dir():
            found.append(AcceptedAsset(folder, record.name))
        elif broken is not None:
            broken.append(record.name)
        else:
            raise InputFileError(
                folder or store.workspace / "assets",
                f"the asset of “{record.name}” isn't there",
                "reopen and accept it again",
            )
    return found


def saved_folder(store: Store, object_id: int) -> Path | None:
    """The asset's folder of an object, also in a workspace that was moved; None without one."""
    return store.assets.folder(store.load(object_id).present.saved)


def keys_of(assets: Iterable[AcceptedAsset]) -> dict[str, AcceptedAsset]:
    """Key → asset; a key has no dot, at which WebDataset cuts names, and no space."""
    out: dict[str, AcceptedAsset] = {}
    for asset in assets:
        plain = re.sub(r"[^A-Za-z0-9_-]+", "_", asset.folder.name).strip("_") or "asset"
        out[free_name(plain, out)] = asset
    return dict(sorted(out.items()))


def check_unchanged(folder: Path, provenance: Mapping[str, Any]) -> None:
    """Check the files of an asset against the sums that were saved with it.

    Raises:
        InputFileError: naming the first file that is missing or was changed since.
    """
    for name, sha256 in provenance["asset"].get("files", {}).items():
        path = folder / name
        if not path.is_file() or file_sha256(path) != sha256:
            what = "was changed since it was accepted" if path.is_file() else "is missing"
            raise InputFileError(path, what, "reopen its object and accept it again")


def public_provenance(provenance: Mapping[str, Any], people: Mapping[str, str]) -> dict[str, Any]:
    """The provenance without folders of this machine, and with numbers instead of people."""

    def plain(value: Any, key: str = "") -> Any:
        if isinstance(value, Mapping):
            return {k: plain(v, k) for k, v in value.items()}
        if isinstance(value, list):
            return [plain(v, key) for v in value]
        if isinstance(value, str) and key in _PEOPLE:
            return people.get(value, "person")
        if isinstance(value, str) and key in _PATHS:
            return PurePath(value).name
        return value

    kept = {k: v if k == "asset" else plain(v, k) for k, v in provenance.items()}
    kept["masks"] = [PurePath(m).name for m in provenance.get("masks") or []]
    return kept


def pseudonyms(provenances: Iterable[Mapping[str, Any]]) -> dict[str, str]:
    """Person → ``person-1``, … in the order of their names, for all assets of a release alike."""
    names = sorted({n for p in provenances for n in _people(p) if n})
    return {name: f"person-{k}" for k, name in enumerate(names, 1)}


def _people(value: Any, key: str = "") -> Iterator[str]:
    if isinstance(value, Mapping):
        for k, v in value.items():
            yield from _people(v, k)
    elif isinstance(value, list):
        for v in value:
            yield from _people(v, key)
    elif isinstance(value, str) and key in _PEOPLE:
        yield value


def files_of(asset: AcceptedAsset, people: Mapping[str, str]) -> dict[str, Path | bytes]:
    """File → where it is, or its new content, of an asset as it is released; sorted by name."""
    kept = read_provenance(asset.folder)
    check_unchanged(asset.folder, kept)
    out: dict[str, Path | bytes] = {
        path.relative_to(asset.folder).as_posix(): path
        for path in asset.folder.rglob("*")
        if path.is_file() and not path.is_symlink()
    }
    out[PROVENANCE] = json_bytes(public_provenance(kept, people))
    return dict(sorted(out.items()))


def described(key: str, asset: AcceptedAsset, files: Mapping[str, Path | bytes]) -> ReleasedAsset:
    """Entry of an asset in the release."""
    kept = read_provenance(asset.folder)
    source, predictor = kept.get("source") or {}, kept.get("predictor") or {}
    sums = {name: sha256_of(content) for name, content in files.items()}
    lines = "".join(f"{sha256}  {name}\n" for name, sha256 in sums.items())
    kinds = Counter(_joint_types(read_json(asset.folder / TREE)))
    return ReleasedAsset(
        key,
        asset.name,
        kept["asset"].get("category") or "",
        predictor.get("backend") or "",
        PurePath(str(source.get("path") or "")).name,
        source.get("sha256") or "",
        (kept.get("review") or {}).get("at") or "",
        (kept.get("gate") or {}).get("verdict") or "",
        len(kept["asset"].get("parts", [])),
        dict(sorted(kinds.items())),
        sum(len(c) if isinstance(c, bytes) else c.stat().st_size for c in files.values()),
        hashlib.sha256(lines.encode()).hexdigest(),
    )


def _joint_types(node: Mapping[str, Any]) -> Iterator[str]:
    """Types of the moving joints in a ``tree.json``."""
    for child in node.get("children", ()):
        if child.get("joint_type") != "fixed":
            yield str(child.get("joint_type"))
        yield from _joint_types(child)


def sha256_of(content: Path | bytes) -> str:
    """SHA-256 of a file or of bytes."""
    if isinstance(content, Path):
        return file_sha256(content)
    return hashlib.sha256(content).hexdigest()


def json_bytes(value: Any) -> bytes:
    """JSON that is the same for the same value."""
    text = json.dumps(value, indent=2, ensure_ascii=False, allow_nan=False)
    return (text + "\n").encode("utf-8", "backslashreplace")


_SHOWN: Final = ("name", "category", "predictor", "joints", "parts", "validation")
"""Fields whose change is named; all else shows as changed files."""


@dataclass(frozen=True)
class AssetChange:
    """An asset that isn't the same in both.

    Attributes:
        key: of the asset.
        kind: added, removed or changed.
        what: human-readable: each field with its values before and after, or "files".
    """

    key: str
    kind: str
    what: tuple[str, ...] = ()


@dataclass(frozen=True)
class ReleaseChanges:
    """Two releases by name and version, and the assets that differ, by key."""

    before: str
    after: str
    same: int
    changes: tuple[AssetChange, ...]

    def to_json(self) -> dict[str, Any]:
        """Plain values, with the number of each kind of change."""
        kinds = [c.kind for c in self.changes]
        counts = {k: kinds.count(k) for k in ("added", "removed", "changed")}
        return asdict(self) | counts | {"changes": [asdict(c) for c in self.changes]}


def changes(before: Release, after: Release) -> ReleaseChanges:
    """Compare two releases asset by asset, whatever their forms."""
    old, new = ({a.key: a for a in r.assets} for r in (before, after))
    out = []
    for key in sorted({*old, *new}):
        if key not in new or key not in old:
            out.append(AssetChange(key, "removed" if key in old else "added"))
        elif what := _changed(old[key], new[key]):
            out.append(AssetChange(key, "changed", what))
    names = (f"{r.name} {r.version}" for r in (before, after))
    return ReleaseChanges(*names, same=len({*old, *new}) - len(out), changes=tuple(out))


def _changed(old: ReleasedAsset, new: ReleasedAsset) -> tuple[str, ...]:
    if old == new:
        return ()
    pairs = [(f, getattr(old, f), getattr(new, f)) for f in _SHOWN]
    named = tuple(f"{f}: {_text(a)} → {_text(b)}" for f, a, b in pairs if a != b)
    return named or ("files",)


def _text(value: Any) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{n} {kind}" for kind, n in value.items()) or "none"
    return str(value) or "none"
