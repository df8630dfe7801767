"""Uploaded files: a limit on them, which viser itself lacks; stored under their content's digest.

A browser announces a file (``FileTransferStartUpload``) and sends its parts, which viser keeps in
memory. The guard checks the announced size and then the bytes received.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from viser import _messages, infra

from model.core.errors import InputFileError
from model.core.files import draft_of
from model.io.geometry_files import SUFFIXES
from model.io.model_files import MODEL_SUFFIXES
from model.io.urdf.files import BORDER, URDF_SUFFIX
from model.io.zips import unpack


def keep_upload(folder: Path, name: str, content: bytes, max_bytes: int) -> Path:
    """Store an uploaded file; returns its path, or the folder that a zip was unpacked to.

    Args:
        folder: folder of all uploads.
        max_bytes: largest unpacked size of a zip.

    Raises:
        InputFileError: where no reader knows it, it is empty, or a zip is damaged or hostile.
    """
    safe = plain_name(name)
    suffix = Path(safe).suffix.lower()
    # An MJCF may consist of boxes alone.
    named = (b"file=", b"<uri>")
    if suffix in MODEL_SUFFIXES and (suffix == URDF_SUFFIX or any(n in content for n in named)):
        raise InputFileError(safe, "its meshes are missing", "zip it with their folder")
    if suffix not in (".zip", *SUFFIXES, *MODEL_SUFFIXES):
        known = ", ".join(sorted(SUFFIXES))
        raise InputFileError(
            safe, "unknown kind of file", f"give one of {known}, or a zip of several"
        )
    if not content:
        raise InputFileError(safe, "the file is empty", "choose one with a mesh or points")
    own = folder / hashlib.sha256(content).hexdigest()[:16]
    if suffix == ".zip":
        return unpack(own / Path(safe).stem, safe, content, max_bytes)
    if not (own / safe).is_file() or (own / safe).read_bytes() != content:
        with draft_of(own / safe) as draft:
            draft.write_bytes(content)
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


@dataclass
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
        limit: bytes of one file, and of all unfinished files of one browser together.
    """

    limit: int
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
        if message.source_component_uuid not in gui._gui_input_handle_from_uuid:
            return False
        if message.transfer_uuid in self._transfers:
            return False
        message.filename = plain_name(message.filename)
        size = message.size_bytes
        total = size + sum(t.declared for t in self._transfers.values() if t.client == client)
        if size < 0 or not 0 <= message.part_count <= size:
            reason = "its announcement is malformed"
        elif size > self.limit:
            reason = f"it has {_readable(size)}"
        elif total > self.limit:
            reason = f"with the unfinished uploads it makes {_readable(total)}"
        else:
            if message.part_count:
                transfer = _Transfer(client, gui, message.filename, size)
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
        reason = f"it is larger than the announced {_readable(transfer.declared)}"
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
            body=f"{name}: {reason}; the limit is {_readable(self.limit)}. "
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


def unfinished_uploads(gui: Any) -> dict[str, int]:
    """Bytes that viser keeps in memory of each unfinished upload."""
    states = gui._current_file_upload_states
    return {key: sum(map(len, state["parts"].values())) for key, state in states.items()}


def _readable(count: int) -> str:
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{count / scale:.3g} {unit}"
    return f"{count} bytes"
