"""A little of `make fuzz` with each run of the tests, what it found once, and that it finds faults at all."""

from __future__ import annotations

import contextlib
import gzip
import io
import math
import os
import subprocess
import time
import zipfile

import numpy as np
import pytest
from hypothesis.errors import HypothesisException
from mcap.stream_reader import StreamReader

from common import config
from fuzz import run as fuzz_run
from fuzz.targets import TARGETS, law
from grasping.lab.dataset import store
from grasping.network import weights
from kst.client import KstClient
from leap_motion import codec as leap_codec
from leap_motion.headset import hand_stream
from leap_rig.recording import recording_files
from reflex import codec as reflex_codec
from rig_simulation.faults import injection

EXAMPLES = 100  # of a target whose cost is 1


def marks_of(target: str) -> list:
    """The marks of a target's tests: some need messages, one opens sockets."""
    return [pytest.mark.ros] * TARGETS[target].ros + [pytest.mark.long] * (target == "control_port")


NAMES = [pytest.param(name, marks=marks_of(name)) for name in TARGETS]

FOUND = [
    ("control_port", b'{"do": "fault", "name": {}, "on": true, "value": 0.3}'),
    ("control_port", b'{"do": "fault", "name": "slow", "value": 1' + b"0" * 400 + b"}"),
    ("control_port", b'{"do": "fault", "name": "slow", "duration": 1' + b"0" * 400 + b"}"),
    ("control_port", b"[" * 2000),
    ("yaml_files", ("tags", "- 0.0\n- 0.0\n")),
    ("yaml_files", ("obstacles", "post: {kind: box, position: [1, 2, " + 400 * "9" + "]}\n")),
    ("yaml_files", ("camera", "camera_matrix: {data: [" + 8 * "0, " + 400 * "9" + "]}\n")),
    ("yaml_files", ("lens", "{camera_matrix: {data: [1]}, image_width: " + 400 * "9" + "}\n")),
    *(
        ("yaml_files", (kind, text))
        for kind in ("hand", "scene", "calibration")
        for text in ("date: 2001-13-45\n", "x: !!int ''\n", "x: !!bool x\n", "[" * 500, "!!map x\n")
    ),
]
"""Targets and inputs that were findings once."""


@pytest.mark.parametrize("name", NAMES)
def test_nothing_is_found(name):
    target = TARGETS[name]
    try_examples = law(target, max(10, int(EXAMPLES / target.cost)))
    ends = time.process_time() + float(os.environ.get("FUZZ_SECONDS", "0"))
    try_examples()
    while time.process_time() < ends:
        try_examples()


def take(name, given):
    """Gives a target one input; its declared errors are none."""
    with contextlib.suppress(*TARGETS[name].declared):
        TARGETS[name].take(given)


@pytest.mark.parametrize(
    ("name", "given"),
    [pytest.param(*each, id=f"{each[0]}-{number}", marks=marks_of(each[0])) for number, each in enumerate(FOUND)],
)
def test_what_was_found_once_stays_mended(name, given):
    take(name, given)


def test_files_that_were_findings_once(monkeypatch):
    packed = bytearray(gzip.compress(b"{}" * 500))
    packed[15] ^= 0xFF
    take("recordings", bytes(packed))
    empty = '{{"currentFrameRate": 115.3, "devices": [], "hands": [], "id": 0, "pointables": [], "timestamp": {}}}'
    for line in (
        *("[" * 2000, '{"hands": ["x"], "pointables": [], "timestamp": 1}', '{"hands": [], "timestamp": 1}'),
        "\n".join(empty.format(stamp) for stamp in (1, 10**400)),
    ):
        take("recordings", line.encode())
    stream = io.BytesIO()
    np.save(stream, np.zeros(3))
    for wrong in ((b"(3,)", b"(3,("), (b"(3,), }" + b" " * 16, b"(300000000000000,), }  ")):
        data = stream.getvalue().replace(*wrong)
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as file:
            file.writestr("x.npy", data)
        with pytest.raises(store.DatasetError):
            store.decode(archive.getvalue())

    def damaged(*_):
        raise RuntimeError("Object visitation failed")

    monkeypatch.setattr(weights.h5py, "File", damaged)
    with pytest.raises(weights.WeightsError, match="visitation"):
        weights.load(weights.HDF5_MAGIC)


PLANTED = {
    "the client takes numbers that are not finite": (
        "kst_client", KstClient, "_numbers", staticmethod(lambda command, reply: np.array(reply.numbers))),
    "a Leap number beyond a float's range ends the driver": (
        "leap_text", leap_codec, "_checked", lambda read, *fields: read(*fields)),
    "a parameter may be NaN": (
        "parameters", config, "is_number", lambda value: type(value) in (int, float) and abs(value) != math.inf),
    "the length of a datagram is not checked": ("reflex_datagrams", reflex_codec, "STATE_BYTES", 198),
    "a damaged file of a run ends its reader": (
        "runs", recording_files, "_records", lambda file: StreamReader(file).records),
    "bytes that are no message raise another error": (
        "human_bytes", "leap_motion.ros.tracking.ReceivedHuman", "deserialize",
        lambda self, data: (self._read_usual(data), self)[1]),
    "a headset's error is the library's": (
        "headset_messages", hand_stream, "_number", lambda value: type(value) is float and math.log(value) < 9.0),
    "a fault's number may be anything": ("control_port", injection, "is_number", lambda value: True),
}  # fmt: skip


@pytest.mark.parametrize("fault", [pytest.param(fault, marks=marks_of(name)) for fault, (name, *_) in PLANTED.items()])
def test_a_planted_fault_is_found(monkeypatch, fault):
    name, place, attribute, wrong = PLANTED[fault]
    try_examples = law(TARGETS[name], 3000, search=False)
    if isinstance(place, str):  # of a module that needs ROS
        monkeypatch.setattr(f"{place}.{attribute}", wrong)
    else:
        monkeypatch.setattr(place, attribute, wrong)
    with pytest.raises(Exception) as found:
        try_examples()
    assert not isinstance(found.value, (HypothesisException, *TARGETS[name].declared))


def test_each_target_has_its_share_of_the_minutes(monkeypatch):
    asked = []

    def run(command, cwd, env, check):
        asked.append((command, env))
        return subprocess.CompletedProcess(command, 1)

    monkeypatch.setattr(fuzz_run.subprocess, "run", run)
    assert fuzz_run.main(["--minutes", "2", "--only", "kst_client", "leap_text"]) == 1
    ((command, env),) = asked
    assert command[-2:] == [
        f"tests/test_fuzz.py::test_nothing_is_found[{name}]" for name in ("kst_client", "leap_text")
    ]
    assert float(env["FUZZ_SECONDS"]) == 60.0 and env["HYPOTHESIS_SEARCH"] == "1"
