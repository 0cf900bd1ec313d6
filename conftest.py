"""What all tests share: the packages on the path without a build, and for tests marked `ros` a master of their own."""

from __future__ import annotations

import contextlib
import functools
import importlib
import multiprocessing.util
import os
import queue
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import hypothesis
import pytest

ROOT = Path(__file__).parent
SHARED = ROOT.parent / "shared"

# A matrix of this project is small: more threads than one cost time.
os.environ.update(OPENBLAS_NUM_THREADS="1", OMP_NUM_THREADS="1")
os.environ.setdefault("QT_QPA_PLATFORM", "offscreen")
# No window opens on the screen of whoever runs the tests; those that need one have one of their own.
os.environ.pop("DISPLAY", None)
os.environ.pop("WAYLAND_DISPLAY", None)
# A run in the background ignores Ctrl-C; what it starts would ignore it, too, and wait to be killed.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Behind everything else: in a sourced workspace the built packages, which also hold the messages, come first.
SOURCES = [str(setup.parent / "src") for setup in sorted(ROOT.glob("src/**/setup.py"))]
sys.path.extend([*SOURCES, str(ROOT)])

from common import clock  # noqa: E402 - needs the path above
from simulated.ports import free_port  # noqa: E402

# On a busy machine one example of a law may take long, to make or to try. Each run tries the same ones: what one finds
# is due to a change. `HYPOTHESIS_SEARCH=1 make test-fast` tries others, HYPOTHESIS_TIMES=10 ten times as many,
# 0.2 a fifth of them.
SEARCH, TIMES = os.environ.get("HYPOTHESIS_SEARCH") == "1", float(os.environ.get("HYPOTHESIS_TIMES", "1"))


def examples(count: int) -> int:
    """Returns how many examples of a law are tried in this run, where it asks for so many."""
    return max(1, round(TIMES * count))


TOO_SLOW = hypothesis.HealthCheck.too_slow
hypothesis.settings.register_profile(
    "tests", deadline=None, max_examples=examples(50), derandomize=not SEARCH, suppress_health_check=[TOO_SLOW]
)
hypothesis.settings.load_profile("tests")


OUTSIDE = {"socket.bind", "socket.connect", "socket.sendto", "socket.sendmsg", "subprocess.Popen", "os.posix_spawn"}
OUTSIDE |= {"os.fork", "os.forkpty", "os.system", "pty.spawn"}
"""Python's audit events (sys.addaudithook) of tests that wait for another thread or program."""
WAITS = (
    (time, "sleep", 0), (select, "select", 3),
    (threading.Condition, "wait", 1), (threading.Event, "wait", 1), (queue.Queue, "get", 2),
    (multiprocessing.util, "spawnv_passfds", None),
)  # fmt: skip
"""What raises no event, and the place of its time-out, where it has one; what waits for ever, waits by no clock."""


@pytest.hookimpl(tryfirst=True)  # before pytest selects by marks
def pytest_collection_modifyitems(items):
    """Skips the tests marked `ros` where the workspace is not sourced; see tools/test.sh of the marks."""
    skip = pytest.mark.skip(reason="the workspace is not built and sourced: source devel/setup.bash")
    texts = {path: path.read_text() for path in {item.path for item in items}}
    for item in items:
        hidden = [
            m for m in ("ros", "real", "long") if item.get_closest_marker(m) and f"mark.{m}" not in texts[item.path]
        ]
        if hidden:  # tools/test.sh finds the files of a part by it
            raise pytest.UsageError(f"{item.nodeid}: its file must name the mark {hidden[0]!r}")
        if item.get_closest_marker("ros") and "ROS_PACKAGE_PATH" not in os.environ:
            item.add_marker(skip)
    for law in {getattr(item.obj, "__func__", item.obj) for item in items}:
        own = getattr(law, "_hypothesis_internal_use_settings", None)
        if own is not None:
            checks = {TOO_SLOW, *own.suppress_health_check}
            own = hypothesis.settings(own, max_examples=examples(own.max_examples), suppress_health_check=checks)
            law._hypothesis_internal_use_settings = own


class Watch:
    """Sees what leaves the process during a test, or waits by the clock; Python cannot remove an audit hook again."""

    def __init__(self) -> None:
        self.seen: set[str] = set()
        sys.addaudithook(self._hear)
        for owner, name, place in WAITS:
            setattr(owner, name, self._counted(getattr(owner, name), f"{owner.__name__}.{name}", place))
        clock.sleep = time.sleep

    def _counted(self, real, name: str, place: int | None):
        """Returns it, such that it counts if the test's own thread waits: others may be those of a test before."""

        @functools.wraps(real)
        def counted(*args, **named):
            seconds = 1 if place is None else args[place] if len(args) > place else named.get("timeout")
            if (seconds or 0) > 0 and threading.current_thread() is threading.main_thread() and not _importing():
                self.seen.add(name)
            return real(*args, **named)

        return counted

    def _hear(self, event: str, _) -> None:
        if event in OUTSIDE and not _importing():
            self.seen.add(event)


def _importing() -> bool:
    """Whether a module is being imported: numpy.testing, say, asks a program what this processor can do."""
    frame = sys._getframe()
    while frame is not None and frame.f_globals.get("__name__") != "importlib._bootstrap":
        frame = frame.f_back
    return frame is not None


def pytest_configure(config):
    """Begins to watch what tests do; fails where the workspace is sourced without its messages."""
    config.stash[WATCH] = Watch()
    if "ROS_PACKAGE_PATH" in os.environ:  # files of tests skip without the messages; a build that lacks them must not
        importlib.import_module("rig_msgs.srv")


WATCH = pytest.StashKey[Watch]()


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item):
    """Begins anew for each test, before its fixtures."""
    item.config.stash[WATCH].seen.clear()
    return (yield)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_teardown(item, nextitem):
    """Fails a test that opens sockets, starts programs or waits beside tests that only compute, which displace it."""
    seen = item.config.stash[WATCH].seen
    mine = set(seen)
    yield
    if nextitem is not None and nextitem.parent is item.parent:  # else fixtures of other tests end, too
        mine = seen
    if mine and not any(item.get_closest_marker(mark) for mark in ("real", "long")):
        pytest.fail(f"it raised {sorted(mine)}: let it run in virtual time, or mark it `real`", pytrace=False)


@pytest.fixture(name="free_port")
def free_port_fixture():
    """The function simulated.ports.free_port."""
    return free_port


@pytest.fixture(scope="session")
def shared_data():
    """The folder of recorded hands and transcripts beside the project; tests that need it skip without it."""
    folder = SHARED / "data"
    if not folder.is_dir():
        pytest.skip("the recordings are not on this machine")
    return folder


@pytest.fixture
def application():
    """The Qt application of this process, without a screen; the test's windows go with the test.

    Left to Python, a window would go whenever its reference cycle is found, in whatever thread: Qt may crash then.
    """
    pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")
    from python_qt_binding.QtCore import QEvent
    from python_qt_binding.QtWidgets import QApplication

    running = QApplication.instance() or QApplication(sys.argv[:1])
    yield running
    for window in running.topLevelWidgets():
        window.deleteLater()
    running.sendPostedEvents(None, QEvent.DeferredDelete)


class Process(subprocess.Popen):
    """A program that a test started; its output goes to the file `log_path`."""

    def __init__(self, command: list[str], log_path: Path, environment: dict[str, str]) -> None:
        self.log_path = log_path
        with open(log_path, "wb") as log:
            super().__init__(command, stdout=log, stderr=subprocess.STDOUT, start_new_session=True, env=environment)

    def wait(self, timeout: float | None = None) -> int:
        """Waits for its end and returns the exit code; `timeout` as for wait_until.

        Fails the test if it lasts longer, with what the program said and where its threads are.
        """
        try:
            return super().wait(None if timeout is None else max(timeout, LONGEST_S))
        except subprocess.TimeoutExpired as error:
            self.send_signal(signal.SIGABRT)  # PYTHONFAULTHANDLER has it print its threads
            self.send_signal(signal.SIGCONT)  # a test may have suspended it
            super().wait(END_S)
            pytest.fail(f"{error}:\n{self.log_path.read_text()}")


END_S = 60.0  # after which a program that does not end is killed


class Processes:
    """Starts programs in process groups of their own and ends each of them with the test."""

    def __init__(self, log_folder: Path) -> None:
        self._log_folder = log_folder
        self._running: list[Process] = []

    def start(self, *command: str, env: dict[str, str] | None = None) -> Process:
        """Starts a command, its output into a file."""
        command = _without_search(command)
        log_path = self._log_folder / f"{len(self._running)}-{Path(command[0]).name}.log"
        if command[0] in ("roslaunch", "roscore"):
            command = (sys.executable, str(ROOT / "tools" / "launcher.py"), *command)
        process = Process([*command], log_path, with_sources(env or {}))
        self._running.append(process)
        return process

    def end(self, process: Process) -> int:
        """Interrupts a process as Ctrl-C does, kills its group if that does not help, returns its exit code."""
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            process.send_signal(signal.SIGCONT)  # a test may have suspended it
            with contextlib.suppress(subprocess.TimeoutExpired):
                subprocess.Popen.wait(process, END_S)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        return process.wait(5.0)

    def end_all(self) -> None:
        """Ends what is still running, newest first."""
        for process in reversed(self._running):
            self.end(process)


def with_sources(changes: dict[str, str]) -> dict[str, str]:
    """Returns this process's environment with these changes, in which the packages are found without a build."""
    paths = [*filter(None, os.environ.get("PYTHONPATH", "").split(os.pathsep)), *SOURCES]
    own = {"PYTHONPATH": os.pathsep.join(paths), "PYTHONUNBUFFERED": "1", "PYTHONFAULTHANDLER": "1"}
    return {**os.environ, **own, **changes}


def _without_search(command: tuple[str, ...]) -> tuple[str, ...]:
    """Returns what rosrun would run: it asks catkin twice where that lies, which costs as much as a small node."""
    if command[0] == "rosrun":
        for prefix in os.environ.get("CMAKE_PREFIX_PATH", "").split(os.pathsep):
            program = Path(prefix, "lib", *command[1:3])
            if program.is_file():
                return (str(program), *command[3:])
    return command


@pytest.fixture(name="without_search")
def without_search_fixture():
    """The function _without_search, for a program with a terminal or input, which `processes` does not start."""
    return _without_search


@pytest.fixture
def processes(tmp_path):
    """Starts programs that end with the test."""
    starter = Processes(tmp_path)
    yield starter
    starter.end_all()


@pytest.fixture(scope="session")
def ros_master(tmp_path_factory):
    """A ROS master on a free port, and this process as a node of it. Yields the master's URI."""
    import rospy

    port = free_port()
    uri = f"http://localhost:{port}"
    folder = tmp_path_factory.mktemp("ros")
    environment = {"ROS_MASTER_URI": uri, "ROS_HOME": str(folder), "ROS_LOG_DIR": str(folder / "log")}
    environment["ROS_ETC_DIR"] = str(_etc_ros(folder / "etc"))
    with pytest.MonkeyPatch.context() as patch:
        for name, value in {**environment, "ROS_HOSTNAME": "localhost"}.items():
            patch.setenv(name, value)
        starter = Processes(folder)
        starter.start("roscore", "-p", str(port))
        wait_until(lambda: _master_answers(uri), 30.0, "the ROS master")
        rospy.init_node("test", anonymous=True, disable_signals=True)
        yield uri
        rospy.signal_shutdown("tests are over")
        starter.end_all()


@pytest.fixture
def ros(request):
    """The test's own graph: in virtual time, and of real processes where the test is marked `real` or `long`."""
    real = any(request.node.get_closest_marker(mark) for mark in ("real", "long"))
    return request.getfixturevalue("real_graph" if real else "virtual_graph")


@pytest.fixture
def real_graph(ros_master, processes, monkeypatch):
    """A graph of processes: what it starts, publishes and hears ends with the test, and the parameters are cleared."""
    import rospy

    topics = []
    make = rospy.topics.Topic.__init__

    def make_and_keep(topic, *args):
        make(topic, *args)
        if threading.current_thread() is threading.main_thread():  # what other threads make they unregister
            topics.append(topic)

    monkeypatch.setattr(rospy.topics.Topic, "__init__", make_and_keep)
    yield Graph(processes)
    processes.end_all()
    for topic in topics:
        topic.unregister()
    # Whole namespaces, as one that is left empty is still there; by the names, as values may come from rospy's cache.
    for name in {name.split("/")[1] for name in rospy.get_param_names()}:
        if not name.startswith(("ros", "run_id")):
            with contextlib.suppress(KeyError):
                rospy.delete_param(f"/{name}")


@pytest.fixture
def wires():
    """Sockets in memory and in virtual time, see simulated/wires.py."""
    from simulated.wires import virtual_wires

    with virtual_wires() as made:
        yield made


@pytest.fixture
def virtual_graph():
    """A ROS graph in this process and in virtual time, see simulated/graph.py."""
    from simulated.graph import Graph

    with Graph() as graph:
        yield graph


class Graph:
    """Starts nodes and launch files, and listens to what they publish."""

    def __init__(self, processes: Processes) -> None:
        self._processes = processes

    def run(self, package: str, executable: str, *args: str) -> Process:
        """Starts a node as `rosrun` does."""
        return self._processes.start("rosrun", package, executable, *args)

    def launch(self, package: str, file: str, **args) -> Process:
        """Starts a launch file as `roslaunch` does, all nodes at the same priority."""
        arguments = [f"{k}:={v}" for k, v in args.items()]
        return self._processes.start("roslaunch", "--wait", package, file, *arguments, env={"LEAP_RIG_NICENESS": "0"})

    def record(self, topic: str, message_type) -> list:
        """Returns a list that grows by every message on the topic, with `list.wait(count, timeout)`."""
        import rospy

        messages = Recording()
        rospy.Subscriber(topic, message_type, messages.append, queue_size=1000)
        return messages


SHARED_TOPICS = {"/tf", "/tf_static", "/diagnostics", "/clock"}
"""Those of all arms, where there are two."""


def names_on_the_page(node: str, namespace: str = "") -> dict[str, set[str]]:
    """Returns as the `names` of a virtual graph what the handbook's page of the ROS graph says of a node of the only
    arm, with the names that it has in a namespace, such as /left.
    """
    columns = {"publishes": ("topic", 2), "hears": ("topic", 3), "offers": ("service", 2)}
    found: dict[str, set[str]] = {kind: set() for kind in columns}
    head = ""
    for line in (ROOT / "docs" / "reference" / "interface.md").read_text().splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        head = cells[0] if cells[0] in ("topic", "service", "frame") else head
        for kind, (table, column) in columns.items():
            if cells[0].startswith("`") and head == table and node in cells[column].split(", "):
                name = "/" + cells[0].strip("`")
                found[kind].add(name if name in SHARED_TOPICS else namespace + name)
    return found


@pytest.fixture(name="names_on_the_page")
def names_on_the_page_fixture():
    """The function names_on_the_page."""
    return names_on_the_page


class Recording(list):
    """Messages in the order of their arrival."""

    def wait(self, count: int = 1, timeout: float = 15.0) -> Recording:
        """Waits until `count` messages came in."""
        wait_until(lambda: len(self) >= count, timeout, f"{count} messages (came: {len(self)})")
        return self


LONGEST_S = 240.0
"""Longest wait for what happens by the real clock: no time that a busy machine needs, but before pytest's own limit."""


def wait_until(condition, timeout: float, what: str, poll: float = 0.02):
    """Waits until the condition returns something true, and returns that, as that of a virtual graph does.

    `timeout` is what a quiet machine needs [s]; here the test fails after LONGEST_S at the earliest.
    """
    deadline = time.monotonic() + max(timeout, LONGEST_S)
    while time.monotonic() < deadline:
        result = condition()
        if result:
            return result
        time.sleep(poll)
    pytest.fail(f"waited in vain for {what}")


@pytest.fixture(name="wait_until")
def wait_until_fixture():
    """The function wait_until."""
    return wait_until


def suspend(pid: int) -> None:
    """Stops a process as Ctrl-Z does, and returns when all its threads stand still.

    The signal alone takes effect later on a busy machine: until then a thread may carry out what is asked of it.
    """
    os.kill(pid, signal.SIGSTOP)
    wait_until(lambda: all(_state(thread) == "T" for thread in Path(f"/proc/{pid}/task").iterdir()), 10.0, "the halt")


@pytest.fixture(name="suspend")
def suspend_fixture():
    """The function suspend."""
    return suspend


def _state(thread: Path) -> str:
    """Returns the state of a thread (proc(5), field 3 of stat); "T" once it is stopped or has ended."""
    try:
        stat = (thread / "stat").read_text(errors="replace")
    except (FileNotFoundError, ProcessLookupError):
        return "T"
    return stat[stat.rindex(")") + 2]


def _etc_ros(folder: Path) -> Path:
    """Makes ROS's folder of settings, whose roscore.xml asks no programs for the version of ROS at each roslaunch."""
    import rospkg

    folder.mkdir()
    for file in Path(rospkg.get_etc_ros_dir()).iterdir():
        (folder / file.name).symlink_to(file)
    core = folder / "roscore.xml"
    core.unlink(missing_ok=True)
    versions = "".join(f'<param name="{name}" value="of the tests"/>' for name in ("rosversion", "rosdistro"))
    core.write_text(f'<launch>{versions}<node pkg="rosout" type="rosout" name="rosout" respawn="true"/></launch>')
    return folder


def _master_answers(uri: str) -> bool:
    import xmlrpc.client

    try:
        return xmlrpc.client.ServerProxy(uri).getPid("/test")[0] == 1
    except OSError:
        return False
