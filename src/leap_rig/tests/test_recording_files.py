"""The files of a recording: what is written is read, whatever ends the writing."""

import errno
import os
import resource
import signal
import tracemalloc
import zlib
from random import Random

import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from common.frames import BASE
from leap_rig.recording import recording_files as files
from leap_rig.recording.recording_files import (
    MANIFEST,
    MESSAGES,
    MessageKind,
    RecordingFault,
    RecordingWriter,
    StoredMessage,
    between,
    messages,
    verify,
    write_mcap,
)
from leap_rig.recording.run import pose_in_base

KINDS = (MessageKind("std_msgs/String", "string data\n", "992c", False), MessageKind("std_msgs/Bool", "bool data\n"))
RESERVE = 4096
STORED = st.lists(
    st.builds(
        StoredMessage,
        st.sampled_from(["/a", "/b"]),
        st.sampled_from(KINDS),
        st.integers(0, 2**62),
        st.binary(max_size=99),
    ),
    max_size=20,
)


def writer_in(folder, **files):
    return RecordingWriter(folder, {"name": "x"}, files, 1, RESERVE)


def write(folder, chunks):
    writer = writer_in(folder, a=b"1")
    for chunk in chunks:
        for message in chunk:
            writer.add(message)
        writer.flush()
    return writer


def few(count, size=50, first=0):
    return [
        StoredMessage("/a", KINDS[0], first + i, Random(first + i).getrandbits(8 * size).to_bytes(size, "little"))
        for i in range(count)
    ]


@settings(max_examples=30, deadline=None)
@given(chunks=st.lists(STORED, max_size=5))
def test_what_is_written_is_read(tmp_path_factory, chunks):
    folder = tmp_path_factory.mktemp("r") / "run"
    write(folder, chunks).close(9, "the test", {"/a": 2})
    manifest, remark = verify(folder)
    assert not remark and list(messages(folder / MESSAGES)) == [m for chunk in chunks for m in chunk]
    assert (manifest["complete"], manifest["start_ns"], manifest["end_ns"], manifest["dropped"]) == (
        True,
        1,
        9,
        {"/a": 2},
    )
    assert sum(manifest["topics"].values()) == sum(map(len, chunks))


def test_another_reader_reads_it(tmp_path):
    from mcap.reader import make_reader

    stored = few(5)
    write(tmp_path / "run", [stored[:3], stored[3:]]).close(9, "the test", {})
    with open(tmp_path / "run" / MESSAGES, "rb") as file:
        reader = make_reader(file, validate_crcs=True)
        assert reader.get_header().profile == "ros1" and reader.get_summary().statistics.chunk_count == 2
        found = list(reader.iter_messages())
    assert [message.data for _, _, message in found] == [m.data for m in stored]
    assert {(schema.name, schema.encoding, channel.message_encoding) for schema, channel, _ in found} == {
        ("std_msgs/String", "ros1msg", "ros1")
    }


def test_a_killed_recording_keeps_every_flushed_chunk_wherever_its_file_ends(tmp_path):
    """Reported in https://github.com/ros/ros_comm/issues/1328: most of a bag that was cut off is lost. Tried: a
    recording cut off anywhere.
    """
    chunks, ends = [few(2, 9, first=10 * i) for i in range(3)], []
    writer = writer_in(tmp_path / "run")
    for chunk in chunks:
        for message in chunk:
            writer.add(message)
        writer.flush()
        ends.append(writer.size)
    data = (tmp_path / "run" / MESSAGES).read_bytes()
    assert len(data) == ends[-1]
    for tail in (b"", b"\0" * 64, b"\xff" * 64):
        for end in range(ends[0], len(data) + 1):
            (tmp_path / "torn").write_bytes(data[:end] + tail)
            found = [m.received for m in messages(tmp_path / "torn")]
            whole = sum(e <= end for e in ends)
            assert found[: 2 * whole] == [m.received for chunk in chunks[:whole] for m in chunk], f"{end} of {ends}"
            assert set(found) <= {m.received for chunk in chunks for m in chunk}
    assert "not completed" in verify(tmp_path / "run")[1]


def test_a_killed_recording_that_is_damaged_says_how_much_is_read(tmp_path):
    writer = writer_in(tmp_path / "run")
    file, ends = tmp_path / "run" / MESSAGES, []
    assert "up to a second" in verify(tmp_path / "run")[1]
    for first in (0, 10, 20):
        for message in few(2, 9, first=first):
            writer.add(message)
        writer.flush()
        ends.append(writer.size)
    assert "up to a second" in verify(tmp_path / "run")[1]
    data = bytearray(file.read_bytes())
    data[ends[0] + 60] ^= 1
    file.write_bytes(data)
    assert len(list(messages(file))) == 2
    assert f"only the first {ends[0]} of {ends[2]} bytes" in verify(tmp_path / "run")[1]
    file.unlink()
    with pytest.raises(RecordingFault, match=str(file)):
        verify(tmp_path / "run")


def test_a_damaged_file_never_gives_a_message_that_was_not_recorded(tmp_path):
    stored, random = few(6), Random(0)
    write(tmp_path / "run", [stored[:3], stored[3:]])
    data = (tmp_path / "run" / MESSAGES).read_bytes()
    for at in range(len(data)):
        damaged = bytearray(data)
        damaged[at] ^= random.randint(1, 255)
        (tmp_path / "damaged").write_bytes(damaged)
        assert {m.data for m in messages(tmp_path / "damaged")} <= {m.data for m in stored}


@pytest.mark.parametrize("name", [MESSAGES, "a"])
def test_a_changed_file_is_refused(tmp_path, name):
    write(tmp_path / "run", [few(2)]).close(9, "the test", {})
    file = tmp_path / "run" / name
    data = bytearray(file.read_bytes())
    data[-1] ^= 1
    file.write_bytes(data)
    with pytest.raises(RecordingFault, match=str(file)):
        verify(tmp_path / "run")
    file.unlink()
    with pytest.raises(RecordingFault, match=str(file)):
        verify(tmp_path / "run")


@pytest.mark.parametrize(
    "manifest",
    ["", "[]", "{", "[" * 10**5, '{"format": "another"}', '{"format": "leap_rig recording", "version": 2}',
     '{"format": "leap_rig recording", "version": 1}',
     '{"format": "leap_rig recording", "version": 1, "files": {"../a": "1"}}',
     *(f'{{"format": "leap_rig recording", "version": 1, "files": {{"{name}": "1"}}}}'
       for name in ("..", "", "a/../b", "a\\u0000b", "a\\ud800", "manifest.json")),
     '{"format": "leap_rig recording", "version": true, "files": {}}',
     '{"format": "leap_rig recording", "version": 1, "files": {"a": 1}}',
     '{"format": "leap_rig recording", "version": 1, "files": {}, "task": 1}',
     '{"format": "leap_rig recording", "version": 1, "files": {}, "robot": []}',
     '{"format": "leap_rig recording", "version": 1, "files": {}, "dropped": []}'],
)  # fmt: skip
def test_a_manifest_of_something_else_is_refused(tmp_path, manifest):
    (tmp_path / MANIFEST).write_text(manifest)
    with pytest.raises(RecordingFault):
        verify(tmp_path)


@pytest.mark.parametrize("name", ["../x.yaml", "/{}/x.yaml", "a/b.yaml", MANIFEST, MESSAGES, ""])
def test_a_file_is_written_only_into_its_folder(tmp_path, name):
    folder = tmp_path / "run"
    with pytest.raises(RecordingFault, match="name"):
        writer_in(folder, **{name.format(tmp_path): b"x: 1"})
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", [MANIFEST, MESSAGES, "a"])
@pytest.mark.parametrize("kind", ["pipe", "endless"])
def test_what_is_no_file_is_refused_without_waiting_for_it(tmp_path, name, kind):
    write(tmp_path / "run", [few(2)]).close(9, "the test", {})
    file = tmp_path / "run" / name
    file.unlink()
    if kind == "pipe":
        os.mkfifo(file)
    else:
        file.symlink_to("/dev/zero")
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(
        resource.RLIMIT_AS, (8 * 2**30, limits[1])
    )  # so that an endless file fails instead of the machine
    try:
        with pytest.raises(RecordingFault, match=name):
            verify(tmp_path / "run")
        with pytest.raises(RecordingFault, match=name):
            list(messages(file))
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)


def file_of(path, data, compression="zstd", claimed=None):
    """Writes an MCAP file with one chunk of such bytes, with its right checksum."""
    from mcap.data_stream import RecordBuilder
    from mcap.records import Chunk, Header

    builder = RecordBuilder()
    Header(profile="ros1", library="").write(builder)
    packed = zstandard.compress(data) if compression == "zstd" else data
    size = len(data) if claimed is None else claimed
    Chunk(compression, packed, 0, 0, zlib.crc32(data), size).write(builder)
    path.write_bytes(b"\x89MCAP0\r\n" + builder.end())
    return path


@pytest.mark.parametrize("claimed", [None, 10, 2**40])
def test_a_chunk_that_grows_too_much_is_left_out(tmp_path, monkeypatch, claimed):
    monkeypatch.setattr(files, "LARGEST_CHUNK", 2**22)
    file = file_of(tmp_path / "bomb", bytes(2 * files.LARGEST_CHUNK), claimed=claimed)
    assert file.stat().st_size < 10**5
    tracemalloc.start()
    try:
        assert list(messages(file)) == []
        assert tracemalloc.get_traced_memory()[1] < files.LARGEST_CHUNK
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("compression", ["lz4", "zstd ", "x"])
def test_a_chunk_of_another_compression_is_left_out(tmp_path, compression):
    assert list(messages(file_of(tmp_path / "other", b"garbage", compression))) == []


def test_a_definition_that_is_no_text_is_no_traceback(tmp_path):
    from mcap.data_stream import RecordBuilder
    from mcap.records import Channel, Message, Schema

    builder = RecordBuilder()
    Schema(data=b"\xff\xfe", encoding="ros1msg", id=1, name="a/b").write(builder)
    Channel(id=1, topic="/a", message_encoding="ros1", metadata={}, schema_id=1).write(builder)
    Message(channel_id=1, log_time=5, data=b"1", publish_time=5, sequence=0).write(builder)
    assert [m.data for m in messages(file_of(tmp_path / "file", builder.end()))] == [b"1"]


class FullDisk:
    """os.write on a disk with so many bytes left; the reserve counts as free once it is closed."""

    def __init__(self, monkeypatch, left):
        self.left, self._write = left, os.write
        monkeypatch.setattr(files.os, "write", self.write)

    def write(self, descriptor, data):
        count = min(len(data), self.left)
        if data and not count:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.left -= count
        return self._write(descriptor, bytes(data[:count]))


@pytest.mark.parametrize("left", [300, 700, 1100])
def test_a_full_disk_ends_the_recording_in_a_valid_folder(tmp_path, monkeypatch, left):
    disk, stored = FullDisk(monkeypatch, left), few(40, 100)
    writer, flushed = writer_in(tmp_path / "run"), 0
    with pytest.raises(OSError, match="No space"):
        for message in stored:
            writer.add(message)
            flushed += 1
            writer.flush()
    disk.left = RESERVE * 8
    writer.close(9, "No space left on device", {})
    manifest, remark = verify(tmp_path / "run")
    assert not remark and "No space" in manifest["ended_by"]
    assert [m.received for m in messages(tmp_path / "run" / MESSAGES)] == list(range(flushed))


def test_a_disk_without_room_for_the_index_keeps_what_was_flushed(tmp_path, monkeypatch):
    FullDisk(monkeypatch, 700)
    writer, stored, flushed = writer_in(tmp_path / "run"), few(40, 100), -1
    with pytest.raises(OSError, match="No space"):
        for message in stored:
            writer.add(message)
            flushed += 1
            writer.flush()
    assert (tmp_path / "run" / MESSAGES).stat().st_size == writer.size
    with pytest.raises(RecordingFault, match="could not be completed"):
        writer.close(9, "No space left on device", {})
    manifest, remark = verify(tmp_path / "run")
    assert remark and manifest["ended_by"] == "No space left on device"
    assert [m.received for m in messages(tmp_path / "run" / MESSAGES)] == list(range(flushed))


def test_nothing_starts_on_a_disk_without_the_reserve(tmp_path, monkeypatch):
    def no_room(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(files.os, "posix_fallocate", no_room)
    with pytest.raises(RecordingFault, match="No space"):
        writer_in(tmp_path / "run", a=b"1")
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize("left", [0, 100, 3000])
def test_a_full_disk_leaves_no_part_of_an_export(tmp_path, left):
    def full():
        yield from few(20, 300)
        resource.setrlimit(resource.RLIMIT_FSIZE, (left, limits[1]))
        yield from few(9000, 300)

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    before = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        with pytest.raises(RecordingFault, match="cannot be written: File too large"):
            write_mcap(tmp_path / "whole.mcap", full(), {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
        signal.signal(signal.SIGXFSZ, before)
    assert not list(tmp_path.iterdir())


def test_an_export_without_a_message_is_refused_and_one_that_exists_stays(tmp_path):
    """Reported in https://github.com/ros/ros_comm/issues/1099: an empty bag: traceback. Tried: an export without a
    message.
    """
    with pytest.raises(RecordingFault, match="no message"):
        write_mcap(tmp_path / "none.mcap", [], {})
    (tmp_path / "there.mcap").write_bytes(b"mine")
    with pytest.raises(RecordingFault, match="exists"):
        write_mcap(tmp_path / "there.mcap", few(1), {})
    assert [file.read_bytes() for file in tmp_path.iterdir()] == [b"mine"]


@pytest.mark.parametrize(("start", "end"), [(5.0, 5.0), (5.0, 1.0), (float("nan"), 5.0), (0.0, float("nan"))])
def test_a_time_without_length_is_refused_before_anything_is_written(tmp_path, start, end):
    with pytest.raises(RecordingFault, match="There is nothing from"):
        write_mcap(tmp_path / "part.mcap", between(tmp_path, ["/a"], start, end), {})
    assert not (tmp_path / "part.mcap").exists()


@pytest.mark.parametrize("slash", ["", "/"])
def test_the_pose_of_a_frame_in_the_base_whatever_slash_its_publisher_writes(slash):
    turn = {"translation": dict(x=1.0, y=0.0, z=0.0), "rotation": dict(x=0.0, y=0.0, z=0.0, w=1.0)}
    edges = ((BASE, "a", 5), ("a", "b", 6))
    transforms = [
        {"child_frame_id": slash + child, "header": {"frame_id": slash + parent, "stamp": stamp}, "transform": turn}
        for parent, child, stamp in edges
    ]
    ((stamp, T),) = pose_in_base(transforms, "b")
    assert (stamp, T[0, 3]) == (6, 2.0)
