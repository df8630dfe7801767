"""The card of a release: its ``README.md``."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from typing import Any, Final

from model.evaluation.markdown import escaped, table
from sessions.releases.contents import Release

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
        'shardshuffle=False)\n```',
    ),
    "huggingface": (
        "`metadata.jsonl` has a row for each asset; its column `urdf` leads to the file.",
        '```python\nfrom datasets import load_dataset\n\nload_dataset("json", '
        'data_files="metadata.jsonl")\n```',
    ),
}  # fmt: skip


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
