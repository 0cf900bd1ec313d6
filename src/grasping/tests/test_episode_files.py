"""Episodes that the disk does not take wait until it does."""

from __future__ import annotations

import errno
import os
from dataclasses import replace

import pytest

pytest.importorskip("rospy")

from episodes import episode

from grasping.lab.dataset.store import decode, file_name
from grasping.lab.ros import episode_files
from grasping.lab.ros.episode_files import EpisodeFiles

pytestmark = pytest.mark.ros


@pytest.fixture
def disk(monkeypatch):
    """A disk that is full until its attribute `full` is False."""

    class Disk:
        full, tried = True, 0

        def write(self, file, content):
            self.tried += 1
            if self.full:
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            file.parent.mkdir(exist_ok=True)
            file.write_bytes(content)

    disk = Disk()
    monkeypatch.setattr(episode_files, "write_whole", disk.write)
    monkeypatch.setattr(episode_files, "RETRY_S", 0.05)
    return disk


@pytest.fixture
def written():
    return []


@pytest.fixture
def files(tmp_path, written):
    files = EpisodeFiles(tmp_path / "data", lambda episode, file, size: written.append((file, size)))
    yield files
    files.close()


def some(count):
    first = episode()
    return [replace(first, t_grasp=first.t_grasp + 10.0 * i) for i in range(count)]


def test_what_a_full_disk_does_not_take_is_written_in_its_order_when_there_is_room(
    disk, files, written, tmp_path, wait_until
):
    three = some(3)
    for one in three:
        waiting = files.waiting
        files.put(one)
        wait_until(lambda before=waiting: files.waiting == before + 1, 10.0, "that it waits")
    assert "An episode waits in memory" in files.fault and "No space left on device" in files.fault
    tried = disk.tried
    wait_until(lambda: disk.tried > tried + 2, 10.0, "further tries")
    disk.full = False
    wait_until(lambda: len(written) == 3, 10.0, "all files")
    assert [file for file, _ in written] == [tmp_path / "data" / file_name(one) for one in three]
    assert [decode(file.read_bytes()).t_grasp for file, _ in written] == [one.t_grasp for one in three]
    assert (files.waiting, files.lost, files.fault) == (0, 0, "")


def test_the_same_grasp_does_not_wait_twice(disk, files, written, wait_until):
    (one,) = some(1)
    files.put(one)
    wait_until(lambda: files.waiting == 1, 10.0, "that it waits")
    files.put(one)
    wait_until(lambda: files.lost == 1, 10.0, "the second one")
    disk.full = False
    wait_until(lambda: len(written) == 1, 10.0, "the file")


def test_memory_is_bounded_and_the_end_names_what_is_lost(disk, files, monkeypatch, wait_until):
    one, other = some(2)
    monkeypatch.setattr(episode_files, "WAITING_BYTES", len(episode_files.encode(one)) + 10)
    files.put(one)
    wait_until(lambda: files.waiting == 1, 10.0, "that it waits")
    files.put(other)
    wait_until(lambda: files.lost == 1, 10.0, "the second one")
    assert "memory. Make room" in files.fault and "waits in memory" in files.fault
    files.close()
    assert files.lost == 2 and "could not be written until the end" in files.fault
