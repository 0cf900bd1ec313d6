"""The robot application, compiled against stubs of KUKA's interface, as a process on loopback."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
from pathlib import Path

import pytest

HERE = Path(__file__).parent
APPLICATION = HERE.parent / "java"
PATIENCE_S = 240.0
"""After which an answer that does not come fails a test; no test expects one earlier."""


@pytest.fixture(scope="session")
def classes(tmp_path_factory):
    """The class path of the application at the language level of Sunrise 1.11, of the stubs and of the unit tests."""
    if shutil.which("javac") is None:
        pytest.skip("openjdk-17-jdk-headless is not installed")
    out = {name: tmp_path_factory.mktemp(name) for name in ("stubs", "application", "unit")}
    compile_java(out["stubs"], 8, HERE / "stubs", [])
    compile_java(out["application"], 7, APPLICATION, [out["stubs"]])
    compile_java(out["unit"], 8, HERE / "java", [out["application"]])
    return os.pathsep.join(map(str, out.values()))


def compile_java(out, release, sources, path):
    """Compiles a folder; any warning but that of an old language level fails."""
    files = sorted(map(str, sources.rglob("*.java")))
    options = ["--release", str(release), "-Xlint:all,-options,-classfile", "-Werror", "-encoding", "UTF-8"]
    command = ["javac", *options, "-d", str(out), "-cp", os.pathsep.join(map(str, path)), *files]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


class Line:
    """A plain client."""

    def __init__(self, port, host="127.0.0.1"):
        self.socket = socket.create_connection((host, port), PATIENCE_S)
        self.replies = self.socket.makefile("rb")

    def send(self, line):
        self.socket.sendall(f"{line}\n".encode())

    def hear(self):
        """Returns the next line, empty at the end."""
        return self.replies.readline().decode("ascii")

    def ask(self, line):
        self.send(line)
        return self.hear()

    def hello(self):
        """Returns the session's number."""
        answer = self.ask("lrHello_1_")
        assert answer.startswith("ok_lrHello_leapRig_1_"), answer
        return answer.split("_")[4]

    def close(self):
        """Goes without a word."""
        self.replies.close()
        self.socket.close()


class Server:
    """The application as a process; `say` sets what the stub robot is to feel or how fast its time runs."""

    def __init__(self, processes, wait_until, classes, folder, properties):
        self._wait_until, self.values = wait_until, folder / "values.properties"
        self._said: dict[str, object] = {}
        options = {"leaprig.host": "127.0.0.1", "leaprig.port": 0, "sim.values": self.values, **properties}
        self.say()
        defined = [f"-D{key}={value}" for key, value in options.items()]
        command = ["java", "-XX:TieredStopAtLevel=1", "-cp", classes, *defined, "leaprig.LeapRigServer"]
        self.process = processes.start(*command)
        self.port = int(self.wait_for(r"listening on port (\d+)")[1])

    def say(self, **values):
        self._said.update(values)
        new = self.values.with_suffix(".new")
        new.write_text("".join(f"{key}={value}\n" for key, value in self._said.items()))
        os.replace(new, self.values)

    @property
    def log(self):
        return self.process.log_path.read_text()

    def wait_for(self, pattern, count=1):
        """Waits until the log has so many of what the pattern finds; returns the last one."""

        def found():
            assert self.process.poll() is None, self.log
            matches = [*re.finditer(pattern, self.log)]
            return matches[-1] if len(matches) >= count else None

        return self._wait_until(found, 30.0, pattern)

    def connect(self):
        return Line(self.port)

    def served(self):
        """Returns a client that has said hello, as soon as the one before has gone."""
        while True:
            client = self.connect()
            if client.ask("lrHello_1_").startswith("ok_"):
                return client
            client.close()


@pytest.fixture
def serve(classes, processes, wait_until, tmp_path):
    """Starts the application with properties of Java."""
    return lambda **properties: Server(
        processes, wait_until, classes, tmp_path, {k.replace("__", "."): v for k, v in properties.items()}
    )


@pytest.fixture
def line_to():
    """Connects a plain client to a host and port."""
    return lambda host, port: Line(port, host)
