"""The dialog that exports accepted objects: formats, collision, checks, download or folder."""

from __future__ import annotations

import re
import secrets
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import cast

import viser

from app.server.bulk import BulkWork
from app.server.export_tasks import ExportTask, zipped
from app.viewer.panels.widgets import Dialog
from app.viewer.tab import Tab
from app.viewer.words import queue as words
from model.core.errors import CommandError
from model.io.export.registry import exporter_names, load_exporter
from model.io.export.simready import AboutPackage, remember, remembered
from model.physics.collision.build import CollisionSettings, Method
from model.physics.simulation_values import PhysicsSettings
from sessions.project_settings import Project


class Exporting(Dialog):
    """Asks how to export, and has it done.

    Args:
        workspace: gets the exported files, in its folder ``exports``.
        project: whose settings the dialog begins with.
    """

    def __init__(self, tab: Tab, bulk: BulkWork, workspace: Path, project: Project) -> None:
        super().__init__(tab)
        self._bulk, self._project, self._workspace = bulk, project, workspace
        self._exports, self._store = workspace / "exports", workspace / "collision"

    def ask(self, ids: Sequence[int]) -> None:
        """Show the dialog for objects."""
        gui, tab = self._tab.client.gui, self._tab
        author, license = remembered(self._workspace)
        settings = self._project.settings
        author, license = settings.author or author, settings.license or license
        collision = next(k for k, v in words.COLLISIONS.items() if v == settings.collision)
        with self._open(words.title(len(ids))):
            self._formats = {
                name: gui.add_checkbox(
                    name, name in settings.formats, hint=load_exporter(name).description
                )
                for name in exporter_names()
            }
            self._collision = gui.add_dropdown(
                words.COLLISION, tuple(words.COLLISIONS), initial_value=collision
            )
            self._check = gui.add_checkbox(words.CHECK, True, hint=words.CHECK_HINT)
            self._package = gui.add_checkbox(words.PACKAGE, False, hint=words.PACKAGE_HINT)
            self._author = gui.add_text(words.AUTHOR, author or tab.user, visible=False)
            self._license = gui.add_text(
                words.LICENSE, license, visible=False, hint=words.LICENSE_HINT
            )
            self._folder = gui.add_text(words.FOLDER, "", hint=words.FOLDER_HINT)
            begin = gui.add_button(words.BEGIN, icon=viser.Icon.DOWNLOAD, color="blue")
            self._add_close(words.CLOSE)
        tab.on_update(self._package, self._package_chosen)
        begin.on_click(lambda _: tab.act(lambda: self._begin(list(ids))))

    def _package_chosen(self) -> None:
        self._author.visible = self._license.visible = self._package.value

    def _begin(self, ids: list[int]) -> None:
        formats = [name for name, box in self._formats.items() if box.value]
        package = None
        if self._package.value:
            if not (self._author.value.strip() and self._license.value.strip()):
                raise CommandError(words.NEED_PACKAGE)
            package = AboutPackage(self._author.value.strip(), self._license.value.strip())
            remember(self._workspace, package)
            formats = list(dict.fromkeys([*formats, "usd"]))
        if not formats:
            raise CommandError(words.NO_FORMAT)
        physics = physics_settings(words.COLLISIONS[self._collision.value])
        name = self._folder.value.strip()
        out = self._exports / (name or f".{secrets.token_hex(8)}")
        if name and not re.fullmatch(r"\w[\w.-]{0,99}", name):
            raise CommandError(words.BAD_NAME)
        try:
            out.mkdir(parents=True)  # at once, so that nobody else takes it
        except FileExistsError:
            raise CommandError(words.TAKEN) from None
        check, store = self._check.value, self._store

        def task_of(asset: Path) -> ExportTask:
            base = out if len(ids) == 1 else out / asset.name
            folders = tuple((f, base / f if len(formats) > 1 else base) for f in formats)
            return ExportTask(asset, folders, physics, store, check, package=package)

        def done() -> None:
            if name:
                self._tab.notify(words.EXPORT, words.written(str(out)), "green", elsewhere=True)
                return
            try:
                send_folder(self._tab, out, f"artiworld_{'_'.join(formats)}")
            finally:
                shutil.rmtree(out, ignore_errors=True)

        self._bulk.export(ids, task_of, self._notify, done)
        self.close()

    def _notify(self, title: str, text: str, color: str) -> None:
        self._tab.notify(title, text, color, elsewhere=True)


def physics_settings(collision: str) -> PhysicsSettings:
    """Settings with a method of collision: "" for the default, "none" for no shapes."""
    if collision == "none":
        return PhysicsSettings(collision=None)
    if not collision:
        return PhysicsSettings()
    method = cast("Method", collision)
    return PhysicsSettings(collision=CollisionSettings(method=method), declared_shapes=False)


def send_folder(tab: Tab, folder: Path, name: str) -> None:
    """Send a folder as a zip, in which it has that name.

    Raises:
        CommandError: where it is too large.
    """
    content = zipped(folder, name)
    if content is None:
        raise CommandError(words.too_large(str(folder)))
    tab.client.send_file_download(f"{name}.zip", content)
