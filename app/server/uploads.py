"""Uploaded files: a limit on them, which viser itself lacks; stored under their content's digest.

A browser announces a file (``FileTransferStartUpload``) and sends its parts, which viser keeps in
memory. The guard checks the announced size and then the bytes received.
"""

from __future__ import annotations

import hashlib
import io
import re
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, cast

from viser import _messages, infra

from app.server.network import NO_ROOM, Room
from model.core.errors import InputFileError
from model.core.files import draft_of, file_sha256
from model.io.geometry_files import SUFFIXES
from model.io.model_files import MODEL_SUFFIXES
from model.io.urdf.files import BORDER, URDF_SUFFIX
from model.io.zips import unpack


def keep_upload(folder: Path, name: str, content: bytes | BinaryIO, max_bytes: int) -> Path:
    """Store an uploaded file; returns its path, or the folder that a zip was unpacked to.

    Args:
        folder: folder of all uploads.
        content: a file is read in pieces, and closed.
        max_bytes: largest unpacked size of a zip.

    Raises:
        InputFileError: where no reader knows it, it is empty, or a zip is damaged or hostile.
    """
    safe = plain_name(name)
    suffix = Path(safe).suffix.lower()
    with io.BytesIO(content) if isinstance(content, bytes) else content as file:
        head = file.read(1 << 22)  # an MJCF may consist of boxes alone
        bare = suffix == URDF_SUFFIX or b"file=" in head or b"<uri>" in head
        if suffix in MODEL_SUFFIXES and bare:
            raise InputFileError(safe, "its meshes are missing", "zip it with their folder")
        if suffix not in (".zip", *SUFFIXES, *MODEL_SUFFIXES):
            known = ", ".join(sorted(SUFFIXES))
            raise InputFileError(
                safe, "unknown kind of file", f"give one of {known}, or a zip of several"
            )
        if not head:
            raise InputFileError(safe, "the file is empty", "choose one with a mesh or points")
        file.seek(0)
        digest = hashlib.file_digest(cast("Any", file), "sha256").hexdigest()
        own = folder / digest[:16]
        if suffix == ".zip":
            return unpack(own / Path(safe).stem, safe, file, max_bytes)
        if not (own / safe).is_file() or file_sha256(own / safe) != digest:
            file.seek(0)
            with draft_of(own / safe) as draft, draft.open("wb") as out:
                shutil.copyfileobj(file, out)
    (own / BORDER).touch()
    return own / safe


def plain_name(name: str) -> str:
    """Return a file name without folders and special characters, at most 120 characters."""
    last = PurePosixPath(name.replace("\\", "/")).name
    clean = re.sub(r"[^\w .()+-]", "_", last).strip(" .")
    suffix = PurePosixPath(clean).suffix[:10]
    if len(clean) > 120:
        clean = clean[: 120 - len(suffix)] + suffix
    return clean or "upload"


UPDATE_DELAY = 0.4
"""Seconds until the browser has drawn its "uploaded" note, which ours replaces."""

_Handler = Callable[[Any, Any], Any]


@dataclass(eq=False)
class _Transfer:
    client: int
    gui: Any
    name: str
    declared: int
    received: int = 0


@dataclass
class UploadGuard:
    """Refuses uploads beyond the limit, on the server's event loop.

    Attributes:
        limit: bytes of one file.
        room: for the unfinished files of all.
    """

    limit: int
    room: Room
    _transfers: dict[str, _Transfer] = field(default_factory=dict)
    _clients: dict[int, infra.WebsockClientConnection] = field(default_factory=dict)

    def attach(self, endpoint: infra.WebsockMessageHandler) -> None:
        """Put the guard before the upload handlers of the server."""
        handlers = endpoint._incoming_handlers
        for kind, check in (
            (_messages.FileTransferStartUpload, self._start),
            (_messages.FileTransferPart, self._part),
        ):
            (inner,) = handlers[kind]  # viser registers one: a bound method of its GuiApi

            def guarded(
                client: Any,
                message: Any,
                check: Callable[..., bool] = check,
                inner: _Handler = inner,
            ) -> None:
                if check(inner.__self__, client, message):  # type: ignore[attr-defined]
                    inner(client, message)

            handlers[kind] = [guarded]

    def attach_client(self, connection: infra.WebsockClientConnection) -> None:
        """Put the guard before one browser's handlers, before its first message."""
        self._clients[connection.client_id] = connection
        self.attach(connection)

    def forget(self, connection: infra.WebsockClientConnection) -> None:
        """Drop the unfinished uploads of a browser that left."""
        client = connection.client_id
        self._clients.pop(client, None)
        for key in [k for k, t in self._transfers.items() if t.client == client]:
            del self._transfers[key]

    def _start(self, gui: Any, client: int, message: _messages.FileTransferStartUpload) -> bool:
        known = message.source_component_uuid in gui._gui_input_handle_from_uuid
        if not known or message.transfer_uuid in self._transfers:
            return False
        message.filename = plain_name(message.filename)
        size = message.size_bytes
        transfer = _Transfer(client, gui, message.filename, size)
        if size < 0 or not 0 <= message.part_count <= size:
            reason = "its announcement is malformed"
        elif size > self.limit:
            reason = f"it has {size / 1e6:,.6g} MB"
        elif not self.room.take(transfer, size, client):
            reason = NO_ROOM
        else:
            if message.part_count:
                self._transfers[message.transfer_uuid] = transfer
            return True
        self._refuse(client, message, message.filename, reason)
        return False

    def _part(self, gui: Any, client: int, message: _messages.FileTransferPart) -> bool:
        transfer = self._transfers.get(message.transfer_uuid)
        if transfer is None or transfer.client != client or transfer.gui is not gui:
            return False
        transfer.received += len(message.content)
        if transfer.received < transfer.declared:
            return True
        del self._transfers[message.transfer_uuid]
        if transfer.received == transfer.declared:
            return True
        gui._current_file_upload_states.pop(message.transfer_uuid, None)
        reason = f"it is larger than the announced {transfer.declared / 1e6:,.6g} MB"
        self._refuse(client, message, transfer.name, reason)
        return False

    def _refuse(
        self,
        client: int,
        message: _messages.FileTransferStartUpload | _messages.FileTransferPart,
        name: str,
        reason: str,
    ) -> None:
        connection = self._clients.get(client)
        if connection is None:
            return
        size = max(0, getattr(message, "size_bytes", 0))
        # Ends the browser's progress bar, which would lock the button for ever.
        connection.queue_message(
            _messages.FileTransferPartAck(
                source_component_uuid=message.source_component_uuid,
                transfer_uuid=message.transfer_uuid,
                transferred_bytes=size,
                total_bytes=size,
            )
        )
        # The browser's own note has this id; at the ack it says "uploaded".
        note = "upload-" + message.transfer_uuid
        props = _messages.NotificationProps(
            title="Upload refused",
            body=f"{name}: {reason}; the limit is {self.limit / 1e6:,.6g} MB. "
            "Put large files on the server and open them by path.",
            loading=False,
            with_close_button=True,
            auto_close_seconds=None,
            color="red",
        )
        connection.queue_message(_messages.NotificationShowMessage(note, props))
        loop = connection.get_message_buffer().event_loop
        loop.call_later(
            UPDATE_DELAY, connection.queue_message, _messages.NotificationUpdateMessage(note, props)
        )
