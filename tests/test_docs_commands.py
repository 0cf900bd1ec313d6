"""Runs the blocks of commands in the handbook that bear no mark: slow, real hardware, running rig, or screen."""

from __future__ import annotations

import os
import subprocess

import pytest

from tools.handbook import pages

pytestmark = pytest.mark.ros
BLOCKS = [block for page in pages.pages() for block in pages.bash_blocks(page) if not block.marker]


@pytest.fixture
def folder(tmp_path):
    """A folder that looks like the project's and takes what the commands write."""
    for entry in pages.ROOT.iterdir():
        (tmp_path / entry.name).symlink_to(entry)
    return tmp_path


@pytest.mark.parametrize("block", BLOCKS, ids=lambda b: f"{b.page.relative_to(pages.ROOT)}:{b.line}")
def test_runs(block, folder):
    environment = {**os.environ, "ROS_MASTER_URI": "http://127.0.0.1:1"}  # no rig may be touched
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", block.text],
        cwd=folder,
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
        timeout=120.0,
    )
    assert done.returncode == 0, done.stdout


def test_some_are_run():
    assert BLOCKS
