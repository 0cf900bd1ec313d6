"""The process of the node grasp_collection: one that dies while it writes, and what is asked of git."""

from __future__ import annotations

import os
import re
import signal
import sys

import pytest
from episodes import episode

from grasping.lab.dataset.store import decode, encode, file_name

pytest.importorskip("rig_msgs.srv")
from grasping.lab.ros.collection_setup import revision
from grasping.lab.ros.episode_files import EpisodeFiles

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

LONG_S = 180.0


@pytest.fixture
def folder(tmp_path):
    return tmp_path / "grasps"


def files(folder):
    return sorted(folder.glob("*.npz"))


@pytest.mark.real
def test_a_process_that_dies_while_it_writes_leaves_no_episode_but_a_sentence(folder, processes, virtual_graph):
    one = episode()
    whole = folder / file_name(one)
    folder.mkdir()
    whole.write_bytes(encode(one))
    died = folder / whole.name.replace("episode_1970", "episode_1971")
    code = (
        "import os, signal, sys; from pathlib import Path; from common.ros.files import write_whole;"
        "os.fsync = lambda _: os.kill(os.getpid(), signal.SIGKILL);"
        "write_whole(Path(sys.argv[1]), b'half of an episode')"
    )
    assert processes.start(sys.executable, "-c", code, str(died)).wait(LONG_S) == -signal.SIGKILL
    assert files(folder) == [whole] and len(os.listdir(folder)) == 2
    node = virtual_graph.start("files", lambda: EpisodeFiles(folder, print).close())
    assert node.wait(1.0) == 0
    assert "is lost: the process that wrote it died" in node.log_path.read_text()
    assert decode(whole.read_bytes()).held


@pytest.mark.real
def test_the_revision_is_asked_of_git_and_git_writes_nothing(folder, processes):
    def git(*words):
        who = ("-c", "user.name=tests", "-c", "user.email=tests@localhost")
        assert processes.start("git", "-C", str(folder), *who, *words).wait(LONG_S) == 0

    source, index = folder / "source.py", folder / ".git" / "index"
    folder.mkdir()
    source.write_text("one\n")
    assert revision(folder) == ""
    git("init", "-q")
    git("add", "source.py")
    git("commit", "-q", "-m", "one")
    os.utime(source, (1.0, 1.0))  # which a status would note in the index
    before = index.read_bytes()
    assert re.fullmatch("[0-9a-f]{40}", revision(folder))
    assert index.read_bytes() == before
    source.write_text("two\n")
    assert re.fullmatch(r"[0-9a-f]{40}\+", revision(folder))
