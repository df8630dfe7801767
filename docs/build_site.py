"""Build the documentation site: ``make docs``, or ``python docs/build_site.py [SITE]``.

The documents at the top of the repository become pages beside those of ``docs/``, so sources are
gathered in ``build/docs`` first. A broken link fails the build, as does a page that fetches a
script, a style or a picture.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
SOURCES = ROOT / "build" / "docs"
SITE = ROOT / "build" / "site"
DOCUMENTS = ("CHANGELOG.md", "CONTRIBUTING.md", "CONVENTIONS.md", "THIRD_PARTY.md")
"""The documents at the top of the repository that are pages of the site."""


def gather() -> None:
    """Copy the sources; links between ``docs/`` and the top of the repository stay right."""
    shutil.rmtree(SOURCES, ignore_errors=True)
    shutil.copytree(ROOT / "docs", SOURCES, ignore=shutil.ignore_patterns("*.py", "__pycache__"))
    above = re.compile(rf"\]\(((?:\.\./)*)\.\./({'|'.join(map(re.escape, DOCUMENTS))})")
    for page in SOURCES.rglob("*.md"):
        page.write_text(above.sub(r"](\1\2", page.read_text("utf-8")), "utf-8")
    for name in DOCUMENTS:
        text = (ROOT / name).read_text("utf-8").replace("](docs/", "](")
        (SOURCES / name).write_text(text, "utf-8")


def pages_that_fetch() -> list[Path]:
    """Pages that need a network."""
    fetched = re.compile(r"""<(?:script|link|img)[^>]+(?:src|href)=["']?(?:https?:)?//""")
    return [page for page in SITE.rglob("*.html") if fetched.search(page.read_text("utf-8"))]


def main() -> int:
    """Build the site, and copy it to the folder that was given."""
    gather()
    command = [sys.executable, "-m", "zensical", "build", "--clean", "--strict"]
    built = subprocess.run(command, cwd=ROOT, check=False).returncode
    if built == 0 and (pages := pages_that_fetch()):
        print("These fetch something:", *pages, sep="\n", file=sys.stderr)
        return 1
    if built == 0 and len(sys.argv) > 1:
        shutil.copytree(SITE, sys.argv[1], dirs_exist_ok=True)
    return built


if __name__ == "__main__":
    sys.exit(main())
