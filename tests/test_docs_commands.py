"""Runs the commands and programs of the README and the handbook as a reader does, page by page; the marks say how."""

from __future__ import annotations

import shutil
import socket
import subprocess
import sys

import pytest

from tools.handbook import pages
from tools.handbook.pages import BESIDE_RIG, UNTIL_CTRL_C, Block
from tools.handbook.terminal import Terminal
from tools.handbook.walk import Walk

needs_a_screen = pytest.mark.skipif(
    not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="the packages xvfb and xdotool are not installed"
)
pytestmark = [
    pytest.mark.ros,
    needs_a_screen,
    pytest.mark.timeout(1500),
    pytest.mark.xdist_group("pages"),
    pytest.mark.long,
]

BLOCKS = [block for page in pages.pages() for block in pages.blocks(page) if not block.why_not]
BESIDE = sorted({block.page for block in BLOCKS if BESIDE_RIG in block.marks})
ALONE = list(dict.fromkeys(block.page for block in BLOCKS if BESIDE_RIG not in block.marks))
USUAL_PORTS = (11311, 6437, 30001, 30011, 30021)


@pytest.fixture(scope="module")
def walk(tmp_path_factory):
    """Walks through pages, with files that stay for the next call; fails with what went wrong.

    Where the kernel allows it, in a network of its own: there all ports are free, and no robot can be reached.
    """
    folder = tmp_path_factory.mktemp("pages")
    unshare = ["unshare", "--net", "--map-root-user"]
    network = unshare if subprocess.run([*unshare, "true"], capture_output=True).returncode == 0 else []

    def run(*arguments):
        for port in USUAL_PORTS if not network else ():
            with socket.socket() as usual:
                if usual.connect_ex(("127.0.0.1", port)) == 0:
                    pytest.skip(f"port {port} is in use, and this machine allows no network of its own")
        done = subprocess.run(
            ["timeout", "1400", *network, sys.executable, "-m", "tools.handbook.walk", folder, *arguments],
            cwd=pages.ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout

    return run


@pytest.fixture(scope="module")
def walked_beside_the_rig(walk):
    walk("--beside-rig", *BESIDE)


def test_beside_the_running_rig(walked_beside_the_rig):
    pass


@pytest.mark.parametrize("page", ALONE, ids=lambda page: str(page.relative_to(pages.ROOT)))
def test_page(page, walk, request):
    if page in BESIDE:
        request.getfixturevalue("walked_beside_the_rig")  # whose files it uses
    walk(page)


ON_AND_ON = "echo listening on; while true; do sleep 0.1; done"


class TestTerminal:
    """On no master and no screen: what a terminal says of commands that do not do what a page says."""

    @pytest.fixture
    def terminal(self, tmp_path):
        environment = {"ROS_MASTER_URI": "http://127.0.0.1:1", "DISPLAY": ":none"}
        return lambda command: Terminal(command, tmp_path, tmp_path / "log", environment)

    @pytest.mark.parametrize(
        ("command", "fault"),
        [
            ("true", ""),
            ("read -r answer; test $answer = yes", ""),
            ("false; true", "exit code 1"),
            ("echo 'success: False'", "printed 'success: False'"),
            ("echo '[node-1] process has died'", "printed 'has died'"),
            ("sleep 1000 & true", ""),
        ],
    )
    def test_a_command_that_ends(self, terminal, command, fault):
        assert terminal(command).end() == fault

    def test_what_ends_before_it_is_ready(self, terminal):
        assert terminal("exit 3").start() == "ended with 3"

    @pytest.mark.parametrize(
        ("at_ctrl_c", "fault"),
        [("exit 0", ""), ("exit 4", "exit code 4"), ("echo Traceback; exit 0", "printed 'Traceback'")],
    )
    def test_ctrl_c(self, terminal, at_ctrl_c, fault):
        started = terminal(f"trap '{at_ctrl_c}' INT; {ON_AND_ON}")
        assert started.start() == ""
        assert started.interrupt() == fault

    def test_what_is_left_behind(self, terminal, monkeypatch):
        monkeypatch.setattr("tools.handbook.terminal.SOON_S", 1.0)
        until_it_runs = "until grep -q sleep /proc/$!/comm; do sleep 0.1; done"
        started = terminal(f"setsid sleep 1000 & {until_it_runs}; trap 'exit 0' INT; {ON_AND_ON}")
        assert started.start() == ""
        assert started.interrupt() == "left behind: sleep 1000"


def test_lines_until_ctrl_c_take_turns_and_the_last_one_runs_on(tmp_path):
    def line(name):
        return f"trap 'echo {name} ends >> story; exit 0' INT; echo {name} >> story; {ON_AND_ON}"

    page = pages.ROOT / "README.md"
    walk = Walk(tmp_path, {"ROS_MASTER_URI": "http://127.0.0.1:1", "DISPLAY": ":none"})
    walk.section([Block(page, 1, f"{line('a')}\n{line('b')}", (UNTIL_CTRL_C,)), Block(page, 4, "echo c >> story")])
    assert not walk.faults
    assert (tmp_path / "story").read_text().split("\n") == ["a", "a ends", "b", "c", "b ends", ""]
