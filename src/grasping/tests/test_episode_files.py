"""Episodes that the disk does not take wait until it does."""

from __future__ import annotations

import errno
import os
from dataclasses import replace

import pytest

pytest.importorskip("rospy")

from episodes import episode

from common import clock
from grasping.lab.dataset.store import decode, file_name
from grasping.lab.ros import episode_files
from grasping.lab.ros.episode_files import WAITING, EpisodeFiles

pytestmark = pytest.mark.ros

RETRY_S, FLUSH_S = 2.0, 6.0
"""Between two tries to write, and longest wait for the last ones."""


@pytest.fixture
def disk(monkeypatch):
    """A disk that is full until its attribute `full` is False, and that takes so many `seconds` [s] for a file."""

    class Disk:
        full, tried, seconds = True, 0, 0.0

        def write(self, file, content):
            self.tried += 1
            clock.sleep(self.seconds)
            if self.full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(content)

    disk = Disk()
    monkeypatch.setattr(episode_files, "write_whole", disk.write)
    return disk


@pytest.fixture
def written():
    return []


@pytest.fixture
def files(virtual_graph, tmp_path, written):
    files = EpisodeFiles(tmp_path / "data", lambda episode, file, size: written.append((file, size)))
    yield files
    files.close()


def some(count):
    first = episode()
    return [replace(first, t_grasp=first.t_grasp + 10.0 * i) for i in range(count)]


def put(files, episode):
    files.put(episode)
    clock.sleep(0.01)


def test_what_a_full_disk_does_not_take_is_written_in_its_order_when_there_is_room(disk, files, written, tmp_path):
    three = some(3)
    for count, one in enumerate(three, 1):
        put(files, one)
        assert files.waiting == count
    assert "An episode waits in memory" in files.fault and "No space left on device" in files.fault
    assert disk.tried == 3
    clock.sleep(10 * RETRY_S)
    assert disk.tried == 13
    disk.full = False
    clock.sleep(RETRY_S)
    assert [file for file, _ in written] == [tmp_path / "data" / file_name(one) for one in three]
    assert [decode(file.read_bytes()).t_grasp for file, _ in written] == [one.t_grasp for one in three]
    assert (files.waiting, files.lost, files.fault) == (0, 0, "")


def test_the_same_grasp_is_neither_kept_nor_written_twice(disk, files, written):
    (one,) = some(1)
    put(files, one)
    put(files, one)
    assert (files.waiting, files.lost) == (1, 1)
    disk.full = False
    clock.sleep(RETRY_S)
    put(files, one)
    assert (len(written), files.waiting, files.lost) == (1, 0, 2)
    assert f"{written[0][0]} holds that grasp already" in files.fault


def test_memory_is_bounded_and_the_end_names_what_is_lost(disk, files, monkeypatch):
    one, other = some(2)
    monkeypatch.setattr(episode_files, "WAITING_BYTES", len(episode_files.encode(one)) + 10)
    put(files, one)
    put(files, other)
    assert (files.waiting, files.lost) == (1, 1)
    assert "memory. Make room" in files.fault and "waits in memory" in files.fault
    files.close()
    assert files.lost == 2 and "could not be written until the end" in files.fault


def test_a_disk_that_takes_too_long_delays_neither_the_node_nor_its_end(virtual_graph, disk, files, written):
    disk.full, disk.seconds = False, 60.0
    many, began = some(WAITING + 3), clock.monotonic()
    put(files, many[0])
    for one in many[1:]:
        files.put(one)
    assert files.lost == 2 and "2 episodes before it are still being written" in files.fault
    files.close()
    assert FLUSH_S <= clock.monotonic() - began <= 2 * FLUSH_S
    assert "the disk took longer than 6 s" in virtual_graph.here.log
