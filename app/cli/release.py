"""``artiworld release``: data sets of accepted assets."""

from __future__ import annotations

from contextlib import closing
from typing import Any

from app.cli import printing
from app.cli.output import check_output
from app.cli.team_commands import ReleaseCreateCommand, ReleaseDiffCommand, ReleaseImportCommand
from app.server.leftovers import WorkspaceLease
from model.core.errors import ConfigurationError
from model.io.assets.reader import read_provenance
from model.io.export.simready import remembered
from sessions.command_log import check_workspace, open_database
from sessions.quality import pairs_of, seconds_in, summaries
from sessions.release_files import import_release, next_version, read_release, write_release
from sessions.releases import AcceptedAsset, Release, accepted_assets, changes, check_name
from sessions.store import Store


def create(options: ReleaseCreateCommand) -> int:
    """Write a release and print its counts; returns the exit code."""
    name = check_name(options.name, "--name")
    check_workspace(options.workspace, options.database)
    home = options.out or options.workspace / "releases"
    version = check_name(options.version or next_version(home, name), "--version")
    out = home / f"{name}-{version}"
    check_output(home)
    author, license = remembered(options.workspace)
    database = open_database(options.workspace, options.database)
    store = Store(options.workspace, options.database)
    try:
        with closing(WorkspaceLease(options.workspace)), printing.session(options.json) as show:
            again = seconds_in(database)
            pairs, _ = pairs_of(store, again, show.progress)
            wanted = store.project.settings
            release = Release(
                name, version, options.form or wanted.form,
                options.license or wanted.license or license,
                options.author or wanted.author or author, summaries(pairs)["all"]["all"],
            )  # fmt: skip
            store.assets.check_release(out.name)
            found = accepted_assets(store, {second.object for second in again})
            assets = _wanted(found, options.category)
            release = write_release(
                release, assets, out, shard_bytes=options.shard_mb * 1_000_000,
                progress=show.progress,
            )  # fmt: skip
            place = store.assets.keep_release(out)
    finally:
        store.close()
        database.close()
    report = release.to_json() | {"folder": str(out)} | ({"storage": place} if place else {})
    show.result(report, lambda: _print_release(release, place or str(out)))
    return 0


def _wanted(assets: list[AcceptedAsset], categories: tuple[str, ...]) -> list[AcceptedAsset]:
    """Those of some categories; all where none is named."""
    if not categories:
        return assets
    named = {c.casefold() for c in categories}
    of = {a: str(read_provenance(a.folder)["asset"].get("category") or "") for a in assets}
    found = [a for a in assets if of[a].casefold() in named]
    if not found:
        known = ", ".join(sorted({c for c in of.values() if c})) or "none"
        raise ConfigurationError(
            f"no accepted object has the category {', '.join(categories)}; there are: {known}"
        )
    return found


def _print_release(release: Release, out: str) -> None:
    rows = [(name, str(count)) for name, count in sorted(release.count("category").items())]
    title = f"{release.name} {release.version}: {len(release.assets)} assets"
    printing.console().print(printing.table_of(title, ("category", "assets"), rows, ("assets",)))
    if not release.license:
        printing.print_notes(["no licence was given; others may not use it: --license CC-BY-4.0"])
    printing.console().print(f"written to {out}")


def diff(options: ReleaseDiffCommand) -> int:
    """Print what differs; returns the exit code."""
    found = changes(read_release(options.before), read_release(options.after))
    report = found.to_json()
    with printing.session(options.json) as show:
        pass
    show.result(report, lambda: _print_changes(report))
    return 0


def _print_changes(report: dict[str, Any]) -> None:
    title = f"{report['before']} → {report['after']}"
    rows = [(c["kind"], c["key"], "; ".join(c["what"])) for c in report["changes"]]
    printing.console().print(printing.table_of(title, ("", "asset", "what"), rows))
    counts = ", ".join(f"{report[kind]} {kind}" for kind in ("added", "removed", "changed"))
    printing.console().print(f"{counts}, {report['same']} the same")


def import_into(options: ReleaseImportCommand) -> int:
    """Import a release and list its objects; returns the exit code."""
    read_release(options.release)  # a folder that is none makes no workspace
    store = Store(options.into, options.database)
    try:
        with closing(WorkspaceLease(options.into)), printing.session(options.json) as show:
            records = import_release(options.release, store, show.progress)
    finally:
        store.close()
    rows = [{"object": r.id, "name": r.name, "path": str(r.path)} for r in records]
    show.result(rows, lambda: printing.print_records(f"{len(rows)} objects imported", rows))
    return 0
