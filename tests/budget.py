"""The size of the house against ``budget.toml``: ``python -m tests.budget``, part of ``make lint``.

Limits only fall. A feature that was allowed some lines enters what it used under its own name, and
the lines of its tests. Lines may move from package to package.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
FILE = "tests/budget.toml"
PACKAGES = ("app", "model", "sessions")
MOST_MEMBERS = 15
VAGUE = re.compile(r"(What|Who|How|Where|Whether|Of|Those)\b")


def counts() -> dict[str, dict[str, int]]:
    """Table → row → today's number, for each row that the code tells."""
    sources = {p: p.read_text() for folder in PACKAGES for p in (ROOT / folder).rglob("*.py")}
    tests = [p.read_text() for p in (ROOT / "tests").rglob("*.py")]
    lines = {p: len(text.splitlines()) for p, text in sources.items()}
    nodes = [node for text in sources.values() for node in ast.walk(ast.parse(text))]
    package: dict[str, int] = {}
    for path, count in lines.items():
        folders = path.relative_to(ROOT).parts[:-1][:2]
        name = ".".join(folders[:1] if folders[0] == "sessions" else folders)
        package[name] = package.get(name, 0) + count
    whole = [*sources.values(), *tests]
    return {
        "house": {
            "lines": sum(lines.values()),
            "files": len(lines),
            "files below 60 lines": sum(n < 60 for n in lines.values()),
            "files below 100 lines": sum(n < 100 for n in lines.values()),
            "lines of tests": sum(len(text.splitlines()) for text in tests),
            "fmt: skip": sum(text.count("# fmt: " + "skip") for text in whole),
            "functions above complexity 15": sum(
                text.count("noqa: C901") for text in whole[: len(lines)]
            ),
            "classes above 15 public members": sum(
                len(members(n)) > MOST_MEMBERS for n in nodes if isinstance(n, ast.ClassDef)
            ),
            "files that name prismatic": sum('"prismatic"' in text for text in sources.values()),
            "files that name screw": sum('"screw"' in text for text in sources.values()),
            "docstrings that name no thing": sum(map(vague, nodes)),
        },
        "packages": package,
    }


def members(node: ast.ClassDef) -> set[str]:
    """Public names that a class body or its constructor gives."""
    found: set[str] = set()
    for child in node.body:
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            found.add(child.name)
            if child.name == "__init__":
                found |= set(_stored(child))
        elif isinstance(child, ast.AnnAssign) and isinstance(child.target, ast.Name):
            found.add(child.target.id)
        elif isinstance(child, ast.Assign):
            found |= {t.id for t in child.targets if isinstance(t, ast.Name)}
    return {name for name in found if not name.startswith("_")}


def _stored(constructor: ast.AST) -> Iterator[str]:
    for node in ast.walk(constructor):
        if isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            yield node.attr


def vague(node: ast.AST) -> bool:
    """True for a docstring that begins with a question word instead of the thing."""
    documented = ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    text = ast.get_docstring(node) if isinstance(node, documented) else None
    return text is not None and VAGUE.match(text) is not None


def limits_of(text: str) -> dict[str, dict[str, int]]:
    """Table → row → limit, with the lines that features used of their allowances."""
    told = tomllib.loads(text)
    for name, entry in told["allowances"].items():
        if entry["used"] > entry["most"]:
            raise ValueError(f"{name!r} used {entry['used']} of {entry['most']} lines")
    used, tested = (sum(e[k] for e in told["allowances"].values()) for k in ("used", "tests"))
    told["house"]["lines"] += used
    told["house"]["lines of tests"] += tested
    told["packages"] = {name: limit + used for name, limit in told["packages"].items()}
    return {table: told[table] for table in ("house", "packages")}


def problems(now: Mapping[str, Mapping[str, int]], limits: Mapping[str, Any]) -> Iterator[str]:
    """One line for each row above its limit, and for each package without one."""
    for table, rows in now.items():
        for row, count in rows.items():
            limit = limits[table].get(row)
            if limit is None:
                yield f"{row}: has no limit in {FILE}"
            elif count > limit:
                yield f"{row}: {count:,}, {count - limit:,} above the limit"


def raised(limits: Mapping[str, Any], before: Mapping[str, Any]) -> Iterator[str]:
    """One line for each limit above the one that it had before."""
    limits, before = (
        {**told, "packages": {"packages": sum(told.get("packages", {}).values())}}
        for told in (limits, before)
    )
    for table in ("house", "packages", "click"):
        for row, limit in before.get(table, {}).items():
            if limits.get(table, {}).get(row, 0) > limit:
                yield f"{row}: the limit rose from {limit:,} to {limits[table][row]:,}"


def earlier() -> dict[str, Any] | None:
    """The limits of the last commit but one that changed them; None where there is none."""
    log = ["git", "log", "--format=%H", "-2", "--", FILE]
    found = subprocess.run(
        log, cwd=ROOT, capture_output=True, text=True, check=False
    ).stdout.split()
    if len(found) < 2:
        return None
    show = ["git", "show", f"{found[1]}:{FILE}"]
    text = subprocess.run(show, cwd=ROOT, capture_output=True, text=True, check=True).stdout
    return tomllib.loads(text)


def main() -> int:
    """Print the table; 1 where something is above its limit."""
    text = (ROOT / FILE).read_text()
    now, limits = counts(), limits_of(text)
    goals = tomllib.loads(text)["goals"]
    print(f"{'':34}{'today':>9}{'limit':>9}{'goal':>9}")
    for table, rows in now.items():
        for row, count in rows.items():
            goal = f"{goals[row]:,}" if row in goals else ""
            print(f"{row:34}{count:>9,}{limits[table].get(row, 0):>9,}{goal:>9}")
    before = earlier()
    found = [
        *problems(now, limits),
        *([] if before is None else raised(tomllib.loads(text), before)),
    ]
    print("\n".join(found) or "within the budget")
    return bool(found)


if __name__ == "__main__":
    sys.exit(main())
