"""The XtionNode's client before a stand-in of the library, and before the library's own dummy device."""

import dataclasses
import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
import yaml

from common import clock
from common.camera_model import pinhole
from common.config import parse
from common.errors import DeviceError
from simulated.clock import virtual_time
from vision.camera.openni_camera import OpenniCamera, XtionConfig

FAKES = Path(__file__).parent / "fake_openni"
CONFIG = parse(XtionConfig, yaml.safe_load((Path(__file__).parents[1] / "config" / "xtion.yaml").read_text()))
MODEL = pinhole("small", 32, 24, np.eye(3))


@pytest.fixture
def fake(monkeypatch, tmp_path):
    """Puts the stand-in in the library's place; returns the file that tells it what to do, and what it was told."""
    state = tmp_path / "camera"
    state.write_text("present")
    monkeypatch.setenv("FAKE_CAMERA", str(state))
    for name in ("openni", "openni.openni2"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    monkeypatch.syspath_prepend(str(FAKES))
    calls = importlib.import_module("openni.openni2").calls
    yield state, calls
    for name in ("openni", "openni.openni2"):
        sys.modules.pop(name, None)


@pytest.fixture
def virtual():
    """Virtual time."""
    with virtual_time():
        yield


def test_both_streams_come_as_they_are(fake, virtual):
    camera = OpenniCamera(CONFIG, MODEL, MODEL)
    assert camera.connect() == "Fake Camera"
    assert camera.serial() == "1207290099"
    frames = {frame.name: frame.image for frame in (camera.read(1.0) for _ in range(4))}
    assert frames["rgb"].shape == (24, 32, 3) and frames["rgb"].dtype == np.uint8
    np.testing.assert_array_equal(frames["rgb"], np.broadcast_to([2, 2, 9], (24, 32, 3)))
    assert frames["depth"].shape == (24, 32) and frames["depth"].dtype == np.uint16
    np.testing.assert_array_equal(frames["depth"], 1002)


def test_a_device_without_a_serial_number(fake):
    camera = OpenniCamera(CONFIG, MODEL, MODEL)
    fake[0].write_text("nameless")
    camera.connect()
    assert camera.serial() == ""


def test_the_device_is_set_up_and_closed_in_the_librarys_order(fake):
    camera = OpenniCamera(CONFIG, MODEL, MODEL)
    camera.connect()
    camera.disconnect()
    camera.disconnect()
    assert fake[1] == [
        ("open", None),
        ("mode", "colour", 32, 24, 30, 200),
        ("mirroring", "colour", False),
        ("start", "colour"),
        ("mode", "depth", 32, 24, 30, 100),
        ("mirroring", "depth", False),
        ("start", "depth"),
        ("registration", 0),
        ("close", "colour"),
        ("close", "depth"),
        "close device",
    ]


def test_registration_is_the_devices_when_it_is_asked_for(fake):
    OpenniCamera(dataclasses.replace(CONFIG, depth_registration=True, device="usb"), MODEL, MODEL).connect()
    assert ("registration", 1) in fake[1] and ("open", b"usb") in fake[1]


@pytest.mark.parametrize(
    "does, sentence",
    [
        ("absent", "no devices found"),
        ("unable", "no rgb images"),
    ],
)
def test_a_camera_that_is_missing_or_unable_is_refused(fake, does, sentence):
    camera = OpenniCamera(CONFIG, MODEL, MODEL)
    fake[0].write_text(does)
    with pytest.raises(DeviceError, match=sentence):
        camera.connect()
    assert fake[1] == ([] if does == "absent" else [("open", None), ("close", "colour"), "close device"])


def test_silence_is_no_image_and_a_camera_pulled_out_an_error(fake, virtual):
    camera = OpenniCamera(CONFIG, MODEL, MODEL)
    camera.connect()
    fake[0].write_text("silent")
    began = clock.monotonic()
    assert camera.read(0.5) is None and clock.monotonic() - began == pytest.approx(0.5)
    fake[0].write_text("absent")
    with pytest.raises(DeviceError, match="device is gone"):
        camera.read(0.01)


def test_a_missing_library_is_named(fake):
    fake[0].write_text("unloadable")
    with pytest.raises(DeviceError, match="libopenni2-dev"):
        OpenniCamera(CONFIG, MODEL, MODEL)


def test_a_missing_package_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "openni", None)
    with pytest.raises(DeviceError, match="openni"):
        OpenniCamera(CONFIG, MODEL, MODEL)


@pytest.mark.long
def test_the_librarys_own_dummy_device_sends_depth_and_colour(processes, wait_until):
    """In a process of its own: the dummy driver often crashes when its streams end."""
    pytest.importorskip("openni")
    try:
        OpenniCamera(CONFIG, MODEL, MODEL)
    except DeviceError as error:
        pytest.skip(str(error))
    program = """
import dataclasses, sys
from pathlib import Path
import numpy as np, yaml
from common.camera_model import pinhole
from common.config import parse
from vision.camera.openni_camera import OpenniCamera, XtionConfig

values = yaml.safe_load(Path(sys.argv[1]).read_text())
model = pinhole("dummy", 320, 240, np.eye(3))
camera = OpenniCamera(parse(XtionConfig, {**values, "device": "Dummy"}), model, model)
camera.connect()
seen = {}
while len(seen) < 2:
    frame = camera.read(5.0)
    seen[frame.name] = frame.image.shape
print(sorted(seen.items()), flush=True)
"""
    config = str(Path(__file__).parents[1] / "config" / "xtion.yaml")
    process = processes.start(sys.executable, "-c", program, config)
    expected = "[('depth', (240, 320)), ('rgb', (240, 320, 3))]"
    wait_until(lambda: expected in process.log_path.read_text(), 20.0, "images of the dummy device")
