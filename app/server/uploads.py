"""Uploaded files: a limit on them, which viser itself lacks; stored under their content's digest;
zips are checked and unpacked.

A browser announces a file (``FileTransferStartUpload``) and sends its parts, which viser keeps in
memory. The guard checks the announced size and then the bytes received.
"""

from __future__ import annotations

import hashlib
import io
import lzma
import os
import re
import stat
import struct
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any

from viser import _messages, infra

from model.core.errors import InputFileError
from model.core.files import draft_of
from model.io.geometry_files import SUFFIXES
from model.io.model_files import MODEL_SUFFIXES
from model.io.urdf.files import URDF_SUFFIX

MAX_FILES = 5000
MAX_RATIO = 200
"""Largest compression ratio of a zip; meshes compress less."""
_RATIO_FROM = 50_000_000
"""Unpacked bytes up to which any ratio is allowed."""
_BLOCK = 1 << 20
DAMAGED = (zipfile.BadZipFile, zlib.error, lzma.LZMAError, struct.error, NotImplementedError,
           RuntimeError, EOFError, ValueError, OverflowError, MemoryError)  # fmt: skip
"""Exceptions of zipfile where a zip is damaged."""
_BESIDE = (".mtl", ".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".bin", ".urdf",
           ".mjcf", ".msh", ".json", ".txt", ".csv", ".xml", ".md")  # fmt: skip
_WANTED = frozenset((*SUFFIXES, *_BESIDE))
_Files = list[tuple[PurePosixPath, zipfile.ZipInfo]]


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
        return _unpacked(own / Path(safe).stem, safe, content, max_bytes)
    if not (own / safe).is_file() or (own / safe).read_bytes() != content:
        with draft_of(own / safe) as draft:
            draft.write_bytes(content)
    return own / safe


def _unpacked(target: Path, name: str, content: bytes, max_bytes: int) -> Path:
    try:
        with zipfile.ZipFile(io.BytesIO(content)) as archive:
            files = _files_in(archive, name)
            if not _is_whole(target, files):
                with draft_of(target, lambda there: _is_whole(there, files)) as draft:
                    _extract(archive, files, draft, name, len(content), max_bytes)
                    if target.is_dir():  # a former version left it, and its objects may be open
                        _complete(target, files, draft)
    except (*DAMAGED, OSError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise  # such as a full disk; a damaged bz2 stream has no number
        raise InputFileError(
            name, f"is not a readable zip ({error})", "pack it again, without a password"
        ) from error
    return target


def _files_in(archive: zipfile.ZipFile, name: str) -> _Files:
    """Files to unpack, without resource forks, thumbnails and programs."""
    entries = [e for e in archive.infolist() if not e.is_dir()]
    if len(entries) > MAX_FILES:
        raise InputFileError(
            name, f"holds {len(entries):,} files", f"a zip may hold at most {MAX_FILES:,}"
        )
    paths = [(_inside(entry, name), entry) for entry in entries]
    return [(p, e) for p, e in paths if p is not None and p.suffix.lower() in _WANTED]


def _is_whole(folder: Path, files: _Files) -> bool:
    """True if a folder holds all that they hold; former versions left some that lack files."""
    try:
        return folder.is_dir() and all(
            zlib.crc32((folder / path).read_bytes()) == entry.CRC for path, entry in files
        )
    except OSError:
        return False


def _complete(folder: Path, files: _Files, source: Path) -> None:
    """Move what a folder lacks out of ``source`` into it; what it holds stays as old as it is."""
    for path, entry in files:
        if not _is_whole(folder, [(path, entry)]):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            (source / path).replace(folder / path)


def _extract(
    archive: zipfile.ZipFile, files: _Files, target: Path, name: str, size: int, max_bytes: int
) -> None:
    limit, taken = min(max_bytes, max(_RATIO_FROM, MAX_RATIO * size)), 0
    for path, entry in files:
        place = target / path
        try:
            place.parent.mkdir(parents=True, exist_ok=True)
        except (FileExistsError, NotADirectoryError):
            raise InputFileError(name, f"holds a file above {path}", "pack it again") from None
        if place.exists():
            raise InputFileError(name, f"holds {path} twice", "pack it again")
        # The sizes that a zip declares may be wrong, so the written bytes are counted.
        with archive.open(entry) as source, place.open("wb") as out:
            while block := source.read(_BLOCK):
                taken += len(block)
                if taken > limit:
                    raise InputFileError(
                        name,
                        f"unpacks to more than {limit / 1e6:.0f} MB",
                        "open large folders by path on the server",
                    )
                out.write(block)
    if not taken:
        raise InputFileError(name, "holds nothing that can be opened", "add meshes or scans to it")


def _inside(entry: zipfile.ZipInfo, name: str) -> PurePosixPath | None:
    """Return an entry's path below the folder; None for one to leave out.

    Raises:
        InputFileError: for a path that leads out of the folder, and for links.
    """
    path = PurePosixPath(entry.filename.replace("\\", "/"))
    odd = (
        path.is_absolute() or ".." in path.parts or ":" in entry.filename or "\0" in entry.filename
    )
    if odd:
        raise InputFileError(
            name, f"holds {entry.filename[:80]!r}, which leads out of it", "pack it again"
        )
    if stat.S_ISLNK(entry.external_attr >> 16):
        raise InputFileError(
            name, f"holds the link {entry.filename[:80]!r}", "pack the file instead"
        )
    if len(os.fsencode(str(path))) > 1000 or any(len(os.fsencode(p)) > 200 for p in path.parts):
        raise InputFileError(name, "holds a file with a very long name", "give it a shorter one")
    if path.parts[0] == "__MACOSX" or path.name.startswith("."):
        return None
    return path


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
