"""A camera of 32 x 24 pixels, as the package's module openni2 shows it.

The file that the environment variable FAKE_CAMERA names says what it does: `present`, `absent` (not plugged in, or
pulled out), `silent` (no images), `unable` (other modes only, no registration), `nameless` (no serial number),
`unloadable` (no library).
"""

import ctypes
import os
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from common import clock

SENSOR_COLOR, SENSOR_DEPTH = "colour", "depth"
PIXEL_FORMAT_RGB888, PIXEL_FORMAT_DEPTH_1_MM = 200, 100
IMAGE_REGISTRATION_DEPTH_TO_COLOR, IMAGE_REGISTRATION_OFF = 1, 0
c_api = SimpleNamespace(ONI_STREAM_PROPERTY_MIRRORING=7, ONI_DEVICE_PROPERTY_SERIAL_NUMBER=3)
WIDTH, HEIGHT, PADDING = 32, 24, 4
calls = []


class OpenNIError(Exception):
    pass


def state():
    return Path(os.environ["FAKE_CAMERA"]).read_text()


def initialize(folders):
    if state() == "unloadable":
        raise OpenNIError("OpenNI2 could not be loaded")


def unload():
    calls.append("unload")


def wait_for_any_stream(streams, timeout):
    if state() == "absent":
        raise OpenNIError("ONI_STATUS_ERROR", b"Stream: device is gone", None)
    if state() == "silent":
        clock.sleep(timeout)
        return None
    clock.sleep(0.01)
    return streams[sum(s.frames for s in streams) % len(streams)]


class Device:
    def __init__(self, uri):
        if state() == "absent":
            raise OpenNIError("ONI_STATUS_ERROR", b"DeviceOpen using default: no devices found", None)
        calls.append(("open", uri))

    def get_device_info(self):
        return SimpleNamespace(vendor=b"Fake", name=b"Camera")

    def get_property(self, number, kind):
        if state() == "nameless":
            raise OpenNIError("ONI_STATUS_NOT_SUPPORTED", b"Device: no such property", None)
        assert number == 3
        return kind(*b"1207290099")

    def create_stream(self, sensor):
        return Stream(sensor)

    def is_image_registration_mode_supported(self, mode):
        return state() != "unable"

    def set_image_registration_mode(self, mode):
        calls.append(("registration", mode))

    def close(self):
        calls.append("close device")


class Stream:
    camera = None

    def __init__(self, sensor):
        self.sensor, self.frames = sensor, 0

    def get_video_mode(self):
        return SimpleNamespace(resolutionX=WIDTH, resolutionY=HEIGHT, fps=15, pixelFormat=0)

    def configure_mode(self, width, height, rate, pixels):
        if state() == "unable":
            raise OpenNIError("ONI_STATUS_ERROR", b"Stream setProperty(3) failed.\n", None)
        calls.append(("mode", self.sensor, width, height, rate, pixels))

    def is_property_supported(self, number):
        return True

    def set_mirroring_enabled(self, on):
        calls.append(("mirroring", self.sensor, on))

    def start(self):
        calls.append(("start", self.sensor))

    def read_frame(self):
        self.frames += 1
        return Frame(self.sensor, self.frames)

    def close(self):
        calls.append(("close", self.sensor))


class Frame:
    """Rows end with bytes that belong to no pixel."""

    width, height = WIDTH, HEIGHT

    def __init__(self, sensor, number):
        if sensor == SENSOR_COLOR:
            pixels = np.full((HEIGHT, WIDTH, 3), number % 256, np.uint8)
            pixels[..., 2] = 9
        else:
            pixels = np.full((HEIGHT, WIDTH, 1), 1000 + number % 100, np.uint16)
        rows = pixels.reshape(HEIGHT, -1).view(np.uint8)
        padded = np.pad(rows, ((0, 0), (0, PADDING)), constant_values=255)
        self.stride = padded.shape[1]
        self._buffer = (ctypes.c_uint8 * padded.size).from_buffer_copy(padded.tobytes())

    def get_buffer_as_uint8(self):
        return self._buffer

    def close(self):
        ctypes.memset(self._buffer, 0, len(self._buffer))
