"""tools/setup.sh takes ROS from where it is, and tools/test.sh ends at Ctrl-C. What they call is replaced, so that
nothing is installed, built or tested.
"""

from __future__ import annotations

import itertools
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = pytest.mark.real

ROOT = Path(__file__).parents[1]
NOTE_CALL = 'echo "$(basename "$0") $* ROS_DISTRO=${ROS_DISTRO:-}" >>"$CALLS"\n'


@pytest.fixture
def project(tmp_path):
    """A folder with the script, the lists, and programs that write down how they were called."""
    (tmp_path / "tools").mkdir()
    for name in (
        "apt-packages.txt",
        "apt-packages-noetic.txt",
        "requirements.txt",
        "requirements-noetic.txt",
        "requirements-webcam.txt",
    ):
        shutil.copy(ROOT / name, tmp_path / name)
    shutil.copy(ROOT / "tools" / "setup.sh", tmp_path / "tools")
    (tmp_path / "requirements-dev.txt").write_text("pytest\n")
    program(tmp_path / "bin" / "dpkg-query", "echo installed")
    program(tmp_path / "bin" / "catkin_make")
    program(tmp_path / ".venv" / "bin" / "python")
    return tmp_path


def program(file: Path, says: str = "") -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(f"#!/usr/bin/env bash\n{NOTE_CALL}{says}\n")
    file.chmod(0o755)


def set_up(project: Path, noetic: Path) -> list[str]:
    """Runs the script; returns how programs were called."""
    return set_up_and_said(project, noetic)[0]


def set_up_and_said(project: Path, noetic: Path) -> tuple[list[str], str]:
    """Runs the script; returns how programs were called, and what it printed."""
    calls = project / "calls"
    environment = {"PATH": f"{project}/bin:{os.defpath}", "CALLS": str(calls), "LEAP_RIG_NOETIC": str(noetic)}
    done = subprocess.run([project / "tools" / "setup.sh"], env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    return calls.read_text().splitlines(), done.stdout


def asked_for(calls: list[str]) -> set[str]:
    return {call.split()[3] for call in calls if call.startswith("dpkg-query")}


def names(file: str) -> set[str]:
    lines = (line.split("#")[0].strip() for line in (ROOT / file).read_text().splitlines())
    return {line for line in lines if line}


def test_without_noetic_debians_packages_are_taken(project):
    calls = set_up(project, project / "nowhere")
    assert asked_for(calls) == names("apt-packages.txt")
    assert calls[-1].startswith("catkin_make") and calls[-1].endswith("ROS_DISTRO=")


def test_with_noetic_its_packages_are_taken_and_the_build_is_on_top_of_it(project):
    noetic = project / "noetic"
    noetic.mkdir()
    # As the real one, it reads variables that a plain terminal lacks.
    (noetic / "setup.bash").write_text('[ -z "$CATKIN_SHELL" ] && export ROS_DISTRO=noetic\n')
    calls = set_up(project, noetic)
    assert asked_for(calls) == names("apt-packages-noetic.txt")
    assert any(call.startswith("python -m pip install -q pip==") for call in calls)
    assert any(call.split(" ROS")[0].endswith(" -rrequirements-noetic.txt") for call in calls)
    assert not any("requirements.txt" in call for call in calls)
    assert calls[-1].startswith("catkin_make") and calls[-1].endswith("ROS_DISTRO=noetic")


def test_mediapipe_brings_no_packages_of_its_own(project):
    (call,) = (call for call in set_up(project, project / "nowhere") if "requirements-webcam.txt" in call)
    assert "--no-deps" in call.split()


def test_without_mediapipe_the_set_up_continues_and_says_so(project):
    program(project / ".venv" / "bin" / "python", 'case "$*" in *webcam*) exit 1 ;; esac')
    calls, said = set_up_and_said(project, project / "nowhere")
    assert "webcam tracker is not available" in said
    assert calls[-1].startswith("catkin_make")


@pytest.mark.parametrize("name", ["my rig", "rig(1)", "it's"])
def test_a_folder_in_which_catkin_builds_nothing_is_refused_at_once(project, name):
    shutil.copytree(project, project.parent / name)
    done = subprocess.run([project.parent / name / "tools" / "setup.sh"], capture_output=True, text=True)
    assert done.returncode == 1 and "Move the folder" in done.stderr and name in done.stderr
    assert not (project.parent / name / "build").exists()


@pytest.mark.parametrize("moved", [False, True])
def test_a_workspace_that_was_moved_is_built_anew(project, moved):
    cache = project / "build" / "CMakeCache.txt"
    cache.parent.mkdir()
    cache.write_text(f"CMAKE_HOME_DIRECTORY:INTERNAL={'/elsewhere' if moved else project.resolve()}/src\n")
    cache.with_name("soak.jsonl").touch()
    (project / "devel").mkdir()
    (project / ".venv" / "bin" / "ruff").touch()
    shutil.copy(ROOT / "Makefile", project)
    (project / "src").mkdir()
    for ready in (project / "build" / ".ready", project / ".venv" / "bin" / "pip"):
        ready.touch()
    os.utime(project / "build" / ".ready", (2e9, 2e9))  # newer than all that it depends on
    asked = subprocess.run(["make", "--question", "build/.ready"], cwd=project, capture_output=True)
    assert (asked.returncode == 1) is moved
    subprocess.run([project / "tools" / "setup.sh", "true"], capture_output=True)
    assert (project / "build" / "soak.jsonl").exists()
    for path in ("devel", ".venv/bin/ruff", "build/CMakeCache.txt"):
        assert (project / path).exists() is not moved, path


PROGRAM = f"""#!{sys.executable}
import os, sys, time
words = " ".join(sys.argv[1:])
open(sys.argv[0] + ".calls", "a").write(words + "\\n")
if os.environ.get("SLOW"):
    try:
        time.sleep(60.0)
    except KeyboardInterrupt:  # as pytest does, which prints its report first
        sys.exit(2)
sys.exit(3 if os.environ.get("FAILS", "none") in os.path.basename(sys.argv[0]) + " " + words else 0)
"""
PARTS = ("make --no-print-directory test-fast", "-m ros and not real and not long", "-m real and not long")


@pytest.fixture
def all_tests(tmp_path):
    """A project whose python and make write down how they were called; starts tools/test.sh in it."""
    for folder in ("bin", "devel", "src", "tests", "tools"):
        (tmp_path / folder).mkdir()
    shutil.copy(ROOT / "tools" / "test.sh", tmp_path / "tools")
    for name in ("python", "make"):
        (tmp_path / "bin" / name).write_text(PROGRAM)
        (tmp_path / "bin" / name).chmod(0o755)
    (tmp_path / "devel" / "setup.bash").touch()
    for mark in ("ros", "real", "long"):
        (tmp_path / "tests" / f"test_{mark}.py").write_text(f"pytestmark = pytest.mark.{mark}\n")

    def start(*options, **variables):
        environment = {**os.environ, "PATH": f"{tmp_path / 'bin'}:{os.defpath}", **variables}
        script = [tmp_path / "tools" / "test.sh", *options]
        return subprocess.Popen(script, env=environment, start_new_session=True, stdout=subprocess.DEVNULL)

    return start


def calls(folder: Path) -> list[str]:
    """How python and make were called, in this order."""
    files = [folder / "bin" / f"{name}.calls" for name in ("python", "make")]
    return [line for file in files if file.exists() for line in file.read_text().splitlines()]


@pytest.mark.parametrize("fails", ["none", *PARTS])
def test_each_part_of_the_tests_runs_and_may_fail(all_tests, tmp_path, fails):
    assert all_tests("-k", "a b", FAILS=fails).wait() == (0 if fails == "none" else 3)
    *of_python, of_make = calls(tmp_path)
    assert f"make {of_make}" == PARTS[0]
    assert [part in call for part, call in zip(PARTS[1:], of_python)] == [True, True]
    assert [call.split("-k a b ")[1] for call in of_python] == ["tests/test_ros.py", "tests/test_real.py"]


def test_what_is_left_for_a_release_runs_alone(all_tests, tmp_path):
    assert all_tests("--long", "-x").wait() == 0
    (call,) = calls(tmp_path)
    assert call.endswith("-m long -x tests/test_long.py")


def test_without_a_build_nothing_is_tested(all_tests, tmp_path):
    (tmp_path / "devel" / "setup.bash").unlink()
    assert all_tests().wait(60.0) != 0
    assert not any("pytest" in call for call in calls(tmp_path))


def test_each_test_belongs_to_one_part():
    from _pytest.mark.expression import Expression

    of_make = re.search(r"test-fast:.*\n.*-m \"(.*)\"", (ROOT / "Makefile").read_text())[1]
    parts = [Expression.compile(text.replace("-m ", "")) for text in (of_make, *PARTS[1:], "long")]
    for marks in itertools.product((False, True), repeat=3):
        of = dict(zip(("ros", "real", "long"), marks))
        assert sum(part.evaluate(of.__getitem__) for part in parts) == 1, of


def test_ctrl_c_ends_all_tests_also_those_to_come(all_tests, tmp_path):
    script = all_tests(SLOW="1")
    try:
        wait_for(lambda: len(calls(tmp_path)) == 1, "the call of make")
        os.killpg(script.pid, signal.SIGINT)  # as a terminal does
        assert script.wait() == 130
    finally:
        if script.poll() is None:
            os.killpg(script.pid, signal.SIGKILL)
    assert len(calls(tmp_path)) == 1, "no other tests begin"
    own = str(tmp_path / "bin").encode()
    wait_for(lambda: not any(own in _bytes(file) for file in Path("/proc").glob("[0-9]*/cmdline")), "the end")


def wait_for(condition, what: str) -> None:
    for _ in range(1200):
        if condition():
            return
        time.sleep(0.05)
    pytest.fail(f"waited in vain for {what}")


def _bytes(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError:  # it has just ended
        return b""


def test_an_environment_whose_making_was_interrupted_is_made_whole(project):
    pip = project / ".venv" / "bin" / "pip"
    program(pip.with_name("python"), f'case "$*" in *--version) exec test -e "{pip}" ;; esac')
    set_up(project, project / "nowhere")
    assert pip.exists()
