"""The folder of a recording, on the disk.

    NAME/manifest.json     what it is, and a hash of every other file
    NAME/messages.mcap     all messages, as ROS 1 wrote them (https://mcap.dev)
    NAME/parameters.yaml   the parameter server at the start
    NAME/...               other files of the start, such as calibrations

Every half second the messages so far become a chunk of their own, which is written and synced: a killed recorder, or
a power cut, loses what came after. The manifest is replaced as a whole, so there is always one."""

from __future__ import annotations

import contextlib
import errno
import hashlib
import json
import os
import re
import shutil
import stat
import struct
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, BinaryIO, cast

import zstandard
from mcap.exceptions import McapError
from mcap.records import Channel, Chunk, Footer, Message, Schema
from mcap.stream_reader import StreamReader, breakup_chunk
from mcap.writer import CompressionType, Writer

from common.errors import RigError
from common.ros.files import FILE_NAME, home, write_whole

FORMAT, VERSION = "leap_rig recording", 1
KINDS = {"task": str, "robot": dict, "dropped": dict}  # of the manifest's values that are read
MANIFEST, MESSAGES, PARAMETERS = "manifest.json", "messages.mcap", "parameters.yaml"
HOME = "leap_rig/recordings"  # in ROS's home, ~/.ros
RESERVE_BYTES = 16 * 2**20  # kept free while a recording runs, for the last chunk and the index on a full disk
CHUNK_BYTES = READ_BYTES = 2**20
STORED_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,199}", re.ASCII)  # of a file beside manifest and messages
LARGEST_CHUNK = 2**28  # a chunk of a damaged or foreign file that would be larger ends the reading


class RecordingFault(RigError):
    """A recording cannot be written or read; the text is one sentence."""


def folder_of(name: str) -> Path:
    """Returns the folder of a recording: a path if `name` has a slash, else one in HOME. RecordingFault: no name."""
    if "/" in name:
        return Path(name)
    if not FILE_NAME.fullmatch(name):
        allowed = (
            "must be up to 100 letters, digits, - and _, and begin with a letter or digit, or be a path with a slash"
        )
        raise RecordingFault(f"The recording's name is {name!r}, but {allowed}.")
    return Path(os.environ.get("ROS_HOME") or home() / ".ros") / HOME / name


@dataclass(frozen=True)
class MessageKind:
    """The type of a topic's messages."""

    name: str  # such as std_msgs/Bool
    definition: str  # in full, with those of the messages within
    md5sum: str = ""
    is_latched: bool = False


@dataclass(frozen=True)
class StoredMessage:
    """One message: its bytes as ROS sent them, and when the recorder received it [ns]."""

    topic: str
    kind: MessageKind
    received: int
    data: bytes


class McapSink:
    """Messages into one MCAP file, chunk by chunk; a chunk ends after `chunk_bytes` or by `end_chunk`."""

    def __init__(self, stream: Any, chunk_bytes: int) -> None:
        self._writer: Any = Writer(stream, chunk_bytes, CompressionType.ZSTD)
        self._writer.start("ros1")
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, MessageKind], int] = {}
        self.attach = self._writer.add_attachment

    def add(self, message: StoredMessage) -> None:
        topic, kind = message.topic, message.kind
        if (topic, kind) not in self._channels:
            if (kind.name, kind.definition) not in self._schemas:
                schema = self._writer.register_schema(kind.name, "ros1msg", kind.definition.encode())
                self._schemas[kind.name, kind.definition] = schema
            known = {"md5sum": kind.md5sum, "topic": topic, **({"latching": "1"} if kind.is_latched else {})}
            channel = self._writer.register_channel(topic, "ros1", self._schemas[kind.name, kind.definition], known)
            self._channels[topic, kind] = channel
        self._writer.add_message(self._channels[topic, kind], message.received, message.data, message.received)

    def end_chunk(self) -> None:
        """Completes the open chunk. The library does so by size only; requirements.txt pins it."""
        self._writer._Writer__finalize_chunk()

    def finish(self) -> None:
        """Completes the last chunk and writes the index."""
        self._writer.finish()


class _Pending:
    """A file to which whole chunks go: bytes wait until `commit` has them on the disk."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
        self._waiting = bytearray()
        self._sha = hashlib.sha256()
        self.size = 0  # on the disk

    def write(self, data: bytes) -> int:
        self._waiting += data
        return len(data)

    def tell(self) -> int:
        return self.size + len(self._waiting)

    def commit(self) -> None:
        """Writes and syncs; after an OSError nothing of what waited counts as written, and all of it still waits."""
        data = memoryview(bytes(self._waiting))
        written = 0
        try:
            while written < len(data):
                written += os.write(self._file, data[written:])
            os.fsync(self._file)
        except OSError:
            os.ftruncate(self._file, self.size)
            os.lseek(self._file, self.size, os.SEEK_SET)
            raise
        self._sha.update(data)
        self.size += len(data)
        self._waiting.clear()

    def close(self) -> str:
        os.close(self._file)
        return self._sha.hexdigest()


class RecordingWriter:
    """Writes a recording; one thread calls it.

    Args:
        folder: must not exist; it is made.
        about: entries of the manifest.
        files: content of further files, by name.
        reserve: bytes that are kept free for the end.

    Raises RecordingFault if the folder exists or cannot be written."""

    def __init__(
        self, folder: Path, about: Mapping[str, Any], files: Mapping[str, bytes], now: int, reserve: int = RESERVE_BYTES
    ) -> None:
        unbounded = 2**62  # bytes of a chunk: time ends it, not its size
        self._folder = folder
        wrong = [name for name in files if not is_stored_name(name)]
        if wrong:
            raise RecordingFault(f"No file of a recording can have the name {wrong[0]!r}.")
        try:
            folder.mkdir(parents=True)
        except FileExistsError as error:
            raise RecordingFault(
                f"{folder} exists already, and nothing is overwritten; choose another name."
            ) from error
        except OSError as error:
            raise RecordingFault(f"{folder} cannot be made: {error.strerror}.") from error
        self._topics: Counter[str] = Counter()
        hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
        self._manifest: dict[str, Any] = {"format": FORMAT, "version": VERSION, **about}
        self._manifest.update(start_ns=now, end_ns=None, complete=False, ended_by="", dropped={}, files=hashes)
        try:
            for name, content in files.items():
                write_whole(folder / name, content)
            self._write_manifest()
            self._spare = tempfile.TemporaryFile(dir=folder)  # noqa: SIM115
            os.posix_fallocate(self._spare.fileno(), 0, reserve)
            self._file = _Pending(folder / MESSAGES)
        except OSError as error:
            shutil.rmtree(folder, ignore_errors=True)  # it was made here; the name is free again
            raise RecordingFault(f"Nothing can be recorded in {folder}: {error.strerror}.") from error
        self._sink = McapSink(self._file, unbounded)

    @property
    def size(self) -> int:
        return self._file.size

    @property
    def count(self) -> int:
        return sum(self._topics.values())

    def add(self, message: StoredMessage) -> None:
        """Adds a message, which `flush` brings to the disk."""
        self._topics[message.topic] += 1
        self._sink.add(message)

    def flush(self, dropped: Mapping[str, int] = MappingProxyType({})) -> None:
        """Brings all messages so far to the disk, but first how many were `dropped` among them by topic, which a reader
        must know even of a recording that is killed. Raises OSError if the disk does not take them; then `close`."""
        if self._manifest["dropped"] != dropped:
            self._manifest["dropped"] = dict(dropped)
            self._write_manifest()
        self._sink.end_chunk()
        self._file.commit()

    def close(self, now: int, ended_by: str, dropped: Mapping[str, int]) -> None:
        """Completes the recording, also on a full disk. Raises RecordingFault if not even the index could be written;
        what was flushed stays readable."""
        self._spare.close()
        self._manifest.update(ended_by=ended_by, dropped=dict(dropped))
        try:
            self._sink.finish()
            self._file.commit()
            complete = True
        except OSError:
            complete = False
        digest = self._file.close()
        if complete:
            self._manifest["files"][MESSAGES] = digest
            self._manifest.update(end_ns=now, complete=True, topics=dict(sorted(self._topics.items())))
        try:
            self._write_manifest()
        except OSError:
            complete = False
        if not complete:
            raise RecordingFault(f"{self._folder} could not be completed: the end of {MESSAGES} is missing.")

    def _write_manifest(self) -> None:
        write_whole(self._folder / MANIFEST, json.dumps(self._manifest, indent=1) + "\n")


def read_manifest(folder: Path) -> dict[str, Any]:
    """Returns the manifest; raises RecordingFault if it does not have this format."""
    largest_manifest = 2**22  # bytes
    try:
        with open_regular(folder / MANIFEST) as file:
            text = file.read(largest_manifest)
        manifest = json.loads(text.decode("utf-8"))
    except OSError as error:
        raise RecordingFault(
            f"There is no recording {folder}: {MANIFEST} cannot be read ({error.strerror})."
        ) from error
    except (ValueError, RecursionError) as error:
        raise RecordingFault(f"{folder / MANIFEST} is not JSON: {error}.") from error
    if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
        raise RecordingFault(f"{folder / MANIFEST} is not of a recording of this rig.")
    if manifest.get("version") is True or manifest.get("version") != VERSION:
        raise RecordingFault(f"{folder} has format version {manifest.get('version')!r}, but {VERSION} is read here.")
    files = manifest.get("files")
    if not isinstance(files, dict) or not all(
        (name == MESSAGES or is_stored_name(name)) and isinstance(digest, str) for name, digest in files.items()
    ):
        raise RecordingFault(f"{folder / MANIFEST} has no valid list of files.")
    for key, kind in KINDS.items():
        if not isinstance(manifest.get(key, kind()), kind):
            raise RecordingFault(f"{folder / MANIFEST} has {key}: {manifest[key]!r}, which record.py does not write.")
    return manifest


def verify(folder: Path) -> tuple[dict[str, Any], str]:
    """Returns the manifest, and a sentence if the recording was not completed, else "". Raises RecordingFault if a file
    is missing or not the one that was recorded."""
    manifest = read_manifest(folder)
    for name, expected in manifest["files"].items():
        try:
            found = _sha256(folder / name)
        except OSError as error:
            raise RecordingFault(f"{folder / name} cannot be read: {error.strerror}.") from error
        if found != expected:
            raise RecordingFault(
                f"{folder / name} was changed since it was recorded: its hash differs, so nothing of it is read. "
                "Take an unchanged copy."
            )
    if manifest.get("complete") is True and MESSAGES in manifest["files"]:
        return manifest, ""
    return manifest, f"{folder} was not completed (power, kill -9 or a full disk): {_missing(folder / MESSAGES)}."


def _missing(path: Path) -> str:
    """Returns what is missing of messages without a hash, whose chunks have checksums."""
    try:
        with open_regular(path) as file:
            size = os.fstat(file.fileno()).st_size
            whole = max((file.tell() for _ in _records(file)), default=0)
    except OSError as error:
        raise RecordingFault(f"{path} cannot be read: {error.strerror}.") from error
    if whole == size:
        return "up to a second is missing at its end"
    return f"only the first {whole} of {size} bytes of {path.name} are whole, and what comes after them is not read"


def write_mcap(path: Path, stored: Iterable[StoredMessage], attachments: Mapping[str, bytes]) -> int:
    """Writes messages and files into one MCAP file and returns the number of messages; RecordingFault: it exists, the
    disk does not take it, or there is no message."""
    count = 0
    with new_file(path) as file:
        sink = McapSink(file, CHUNK_BYTES)
        for name, content in attachments.items():
            sink.attach(0, 0, name, "application/json" if name.endswith(".json") else "application/yaml", content)
        for message in stored:
            sink.add(message)
            count += 1
        sink.finish()
        if not count:
            raise RecordingFault(f"There is no message on these topics in this time, so {path} is not written.")
    return count


@contextlib.contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Opens a file for writing that must not exist, and removes it where that fails; RecordingFault for an OSError."""
    try:
        with open(path, "xb") as file:
            try:
                yield file
                file.flush()
            except Exception:
                path.unlink()
                raise
    except OSError as error:
        raise RecordingFault(f"{path} cannot be written: {error.strerror}.") from error


def is_stored_name(name: str) -> bool:
    """Returns whether a further file of a recording may have this name: one in its folder."""
    return STORED_NAME.fullmatch(name) is not None and name not in (MANIFEST, MESSAGES)


def open_regular(path: Path) -> BinaryIO:
    """Opens a file for reading; OSError also for a pipe or a device, which would be waited for or never end."""
    return open(path, "rb", opener=_open_regular)


def _open_regular(path: str, flags: int) -> int:
    handle = os.open(path, flags | os.O_NONBLOCK)
    if not stat.S_ISREG(os.fstat(handle).st_mode):
        os.close(handle)
        raise OSError(errno.EINVAL, "it is not a regular file", path)
    return handle


def _sha256(path: Path) -> str:
    sha = hashlib.sha256()
    with open_regular(path) as file:
        for part in iter(lambda: file.read(READ_BYTES), b""):
            sha.update(part)
    return sha.hexdigest()


def messages(path: Path) -> Iterator[StoredMessage]:
    """Yields the messages of an MCAP file in the order of their receipt, up to where the file is whole. Raises
    RecordingFault if the file cannot be read."""
    schemas: dict[int, Schema] = {}
    channels: dict[int, tuple[str, MessageKind]] = {}
    try:
        file = open_regular(path)
    except OSError as error:
        raise RecordingFault(f"{path} cannot be read: {error.strerror}.") from error
    with file:
        for record in _records(file):
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel) and record.schema_id in schemas:
                schema, known = schemas[record.schema_id], record.metadata
                md5sum, latching = known.get("md5sum", ""), known.get("latching") == "1"
                channels[record.id] = (
                    record.topic,
                    MessageKind(schema.name, schema.data.decode("utf-8", "replace"), md5sum, latching),
                )
            elif isinstance(record, Message) and record.channel_id in channels:
                yield StoredMessage(*channels[record.channel_id], record.log_time, record.data)


def between(folder: Path, wanted: Iterable[str] | None, start: float, end: float) -> Iterator[StoredMessage]:
    """Returns the messages of the `wanted` topics, of all for None, that were received between `start` and `end` [s]
    after the start of the recording; of latched topics also those before. RecordingFault: there is no time between."""
    if not start < end:  # nor NaN
        raise RecordingFault(f"There is nothing from {start:g} to {end:g} s.")
    return _between(folder, wanted, start, end)


def _between(folder: Path, wanted: Iterable[str] | None, start: float, end: float) -> Iterator[StoredMessage]:
    names, first = None if wanted is None else set(wanted), None
    for message in messages(folder / MESSAGES):
        first = message.received if first is None else first
        after = 1e-9 * (message.received - first)
        if after > end:
            return
        if (names is None or message.topic in names) and (after >= start or message.kind.is_latched):
            yield message


class _Capped:
    """A file whose `read` asks for no more than there is, whatever length a damaged record claims."""

    def __init__(self, file: BinaryIO) -> None:
        self._file, self._size = file, os.fstat(file.fileno()).st_size

    def read(self, length: int) -> bytes:
        return self._file.read(min(length, self._size))


def _records(file: BinaryIO) -> Iterator[Any]:
    """Yields the records of the file and of its chunks, up to the first that is not whole."""
    try:
        for record in StreamReader(cast(Any, _Capped(file)), emit_chunks=True).records:
            if isinstance(record, Chunk):
                if not _is_modest(record):
                    return
                yield from breakup_chunk(record, validate_crc=True)
            elif isinstance(record, Footer):
                return
            else:
                yield record
    except (McapError, ValueError, struct.error, zstandard.ZstdError, OSError, MemoryError, OverflowError):
        return


def _is_modest(chunk: Chunk) -> bool:
    """Returns whether a chunk is compressed as ours are, and not larger than it may be, whatever it claims."""
    if chunk.compression != "zstd":
        return False
    size = zstandard.frame_content_size(chunk.data)  # -1 where the frame does not say it; then the claim bounds it
    return max(chunk.uncompressed_size, size) <= LARGEST_CHUNK
