"""Changes between two releases."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any, Final

from sessions.releases.contents import Release, ReleasedAsset

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
