"""No input becomes code, and what listens is what docs/handbook/security.md says; by reading the source."""

from __future__ import annotations

import ast
import functools
import re
from pathlib import Path

import pytest

from tools.reference.syntax import dotted

ROOT = Path(__file__).parents[1]
FOLDERS = ("src", "golden", "campaign", "examples")
FILES = sorted(
    file for folder in FOLDERS for file in ROOT.glob(f"{folder}/**/*.py") if "tests" not in file.relative_to(ROOT).parts
)
PICKLES = {"pickle", "cPickle", "_pickle", "dill", "cloudpickle", "joblib", "shelve", "marshal", "jsonpickle"}
FORBIDDEN = {"eval", "exec", "os.system", "os.popen", "subprocess.getoutput", "subprocess.getstatusoutput",
             "torch.hub.load", "torch.jit.load", "pandas.read_pickle", "yaml.unsafe_load", "yaml.full_load",
             "yaml.load_all", "yaml.unsafe_load_all", "yaml.full_load_all", "builtins.eval", "builtins.exec",
             "asyncio.create_subprocess_shell"}  # fmt: skip
NEEDED = {"torch.load": "weights_only", "np.load": "allow_pickle", "numpy.load": "allow_pickle",
          "np.lib.format.read_array": "allow_pickle"}  # fmt: skip
NEEDED_VALUE = {"weights_only": True, "allow_pickle": False}

EXCEPTIONS = {
    (
        "src/grasping/src/grasping/network/weights.py",
        "pickle",
    ): "its own unpickler makes tensors, and stubs of the rest",
    ("src/grasping/src/grasping/network/weights.py", "torch.load"): "with that unpickler; published models are pickled",
    ("src/common/src/common/ros/files.py", "yaml.load"): "with a class of yaml.SafeLoader",
}


@functools.lru_cache(maxsize=None)
def nodes_of(code: str) -> list[ast.AST]:
    """Returns all nodes of a file's syntax tree."""
    return list(ast.walk(ast.parse(code)))


def dangers(code: str) -> set[str]:
    """Returns what a file does that could run its input."""
    found = set()
    for node in nodes_of(code):
        if isinstance(node, ast.Import):
            found |= {alias.name.split(".")[0] for alias in node.names} & PICKLES
        elif isinstance(node, ast.ImportFrom):
            module = str(node.module)
            found |= {module.split(".")[0]} & PICKLES
            found |= {f"{module}.{alias.name}" for alias in node.names} & (FORBIDDEN | NEEDED.keys() | {"yaml.load"})
        elif isinstance(node, ast.Call):
            name, options = dotted(node.func), {keyword.arg: keyword.value for keyword in node.keywords}
            found |= {name} & (FORBIDDEN | {"yaml.load"})
            option = NEEDED.get(name)
            if option and not _is(options.get(option), NEEDED_VALUE[option]):
                found.add(name)
            if "shell" in options and not _is(options["shell"], False):
                found.add("shell=True")
    return found


def _is(node: ast.expr | None, value: bool) -> bool:
    return isinstance(node, ast.Constant) and node.value is value


def test_no_input_becomes_code():
    found = {(str(path.relative_to(ROOT)), danger) for path in FILES for danger in dangers(path.read_text())}
    assert len(FILES) > 300
    assert found == EXCEPTIONS.keys(), "each exception needs its argument, and the rest another way"


def test_no_shell_script_evaluates_text():
    scripts = [path for path in ROOT.glob("src/**/*.sh") if re.search(r"^\s*eval\b", path.read_text(), re.MULTILINE)]
    assert not scripts


@pytest.mark.parametrize(
    ("code", "danger"),
    [
        ("import pickle", "pickle"),
        ("from pickle import loads", "pickle"),
        ("import torch\ntorch.load(f)", "torch.load"),
        ("torch.load(f, weights_only=False)", "torch.load"),
        ("np.load(f, allow_pickle=True)", "np.load"),
        ("np.load(f)", "np.load"),
        ("from torch import load", "torch.load"),
        ("yaml.load(f, Loader=yaml.Loader)", "yaml.load"),
        ("eval(text)", "eval"),
        ("subprocess.run(line, shell=True)", "shell=True"),
        ("subprocess.run(line, shell=flag)", "shell=True"),
        ("os.system(line)", "os.system"),
    ],
)
def test_each_danger_is_found(code, danger):
    assert dangers(code) == {danger}


def listens(code: str) -> bool:
    """Returns whether a file binds a socket to an address, or serves WebSockets."""
    nodes = nodes_of(code)
    sockets = any(isinstance(node, ast.Import) and "socket" in {a.name for a in node.names} for node in nodes)
    sockets |= any(isinstance(node, ast.ImportFrom) and node.module == "socket" for node in nodes)
    servers = {
        alias.name
        for node in nodes
        if isinstance(node, ast.ImportFrom) and str(node.module).split(".")[0] in ("websockets", "http", "socketserver")
        for alias in node.names
    } & {"serve", "unix_serve", "HTTPServer", "ThreadingHTTPServer", "TCPServer", "ThreadingTCPServer", "UDPServer"}
    for node in nodes:
        if isinstance(node, ast.Call):
            name = dotted(node.func).rpartition(".")[2]
            binds = name == "bind" and len(node.args) == 1 and (sockets or isinstance(node.args[0], ast.Tuple))
            if binds or name in servers | {"create_server", "start_server", "create_datagram_endpoint"}:
                return True
    return False


@pytest.mark.parametrize(
    ("code", "expected"),
    [
        ('import socket\ns.bind(("127.0.0.1", 0))', True),
        ("import socket\ns.bind(address)", True),
        ("from socket import socket\ns.bind(self._address)", True),
        ("self.socket.bind((host, port))", True),
        ("from websockets.sync.server import serve\nserve(take, host, port)", True),
        ("from http.server import HTTPServer\nHTTPServer(address, Handler)", True),
        ("import asyncio\nasyncio.start_server(take, host, port)", True),
        ("part.bind(self)", False),
        ("import socket\nsocket.create_connection(address)", False),
    ],
)
def test_what_listens_is_found(code, expected):
    assert listens(code) == expected


def test_the_table_names_every_file_that_listens():
    page = (ROOT / "docs/handbook/security.md").read_text()
    table = page.partition("## What listens where")[2].partition("Devices that listen themselves")[0]
    named = {
        (ROOT / "docs/handbook" / link).resolve() for link in re.findall(r"\]\((\.\./\.\./src/[^)]+\.py)\)", table)
    }
    listening = {path for path in FILES if ROOT / "src" in path.parents and listens(path.read_text())}
    assert named == listening


@pytest.mark.hazard(22)
def test_by_default_everything_of_ours_listens_on_loopback():
    for name in ("demo", "rig", "leap_rig", "simulated_devices"):
        text = (ROOT / f"src/leap_rig/launch/{name}.launch").read_text()
        hosts = re.findall(r'<arg name="(?:\w+_)?host" default="([^"]*)"', text) + re.findall(r"--host (\S+)", text)
        assert set(hosts) <= {"127.0.0.1"}
    vision = (ROOT / "src/vision/launch/camera_oculus.launch").read_text()
    assert 'name="web_host" default="127.0.0.1"' in vision
