"""Driver of the Xtion Pro Live with OpenNI 2; every missing part is reported in one sentence. It needs the library
libOpenNI2 with its drivers, and the Python package openni, which wraps it."""

from __future__ import annotations

import atexit
import contextlib
import ctypes
import dataclasses
import sysconfig
from types import ModuleType
from typing import Any

import numpy as np

from common.camera_model import CameraModel
from common.config import flag, integer, number, text
from common.errors import DeviceError

FOLDERS = (f"/usr/lib/{sysconfig.get_config_var('MULTIARCH')}", "/usr/lib64", "/usr/lib", "/usr/local/lib")
ANY = "any"
SerialNumber = ctypes.c_char * 64
NOT_FOUND = "check the USB cable and port, and that the udev rules of libopenni2 are installed"


@dataclasses.dataclass(frozen=True)
class XtionConfig:
    """The schema of xtion.yaml."""

    device: str = text(doc="any, or an OpenNI URI")
    rate: int = integer("Hz", low=1, high=60, doc="images per second")
    depth_registration: bool = flag(doc="let the device register depth to the colour camera's pixels")
    auto_exposure: bool = flag()
    auto_white_balance: bool = flag()
    time_offset: float = number("s", low=-1.0, high=1.0, doc="added to the arrival time to get the time of exposure")


@dataclasses.dataclass(frozen=True)
class OpenniFrame:
    """One image."""

    name: str  # rgb or depth
    image: np.ndarray  # RGB, (height, width, 3), uint8; or depth, (height, width), uint16 [mm], 0: unknown


class OpenniCamera:
    """One device, not thread-safe. The intrinsics `rgb` and `depth` define the sizes of the images. Raises DeviceError
    if the library or the Python package is missing."""

    def __init__(self, config: XtionConfig, rgb: CameraModel, depth: CameraModel) -> None:
        self._config = config
        self._models = {"rgb": rgb, "depth": depth}
        self._openni = _library()
        self._device: Any = None
        self._streams: dict[str, Any] = {}

    def connect(self) -> str:
        """Opens the device, starts both streams and returns the device's name. Raises DeviceError if there is no
        device, or it does not support the configuration."""
        self.disconnect()
        openni = self._openni
        uri = None if self._config.device == ANY else self._config.device.encode()
        try:
            self._device = openni.Device(uri)
        except Exception as error:
            fault = f"No camera answers (device {self._config.device}): {_reason(error)}; {NOT_FOUND}."
            raise DeviceError(fault) from None
        try:
            self._start("rgb", openni.SENSOR_COLOR, openni.PIXEL_FORMAT_RGB888)
            self._start("depth", openni.SENSOR_DEPTH, openni.PIXEL_FORMAT_DEPTH_1_MM)
            wanted, mode = self._config.depth_registration, openni.IMAGE_REGISTRATION_DEPTH_TO_COLOR
            supported = self._device.is_image_registration_mode_supported(mode)
            if wanted and not supported:
                raise DeviceError("The camera cannot register depth to colour itself; set depth_registration to false.")
            if supported:
                self._device.set_image_registration_mode(mode if wanted else openni.IMAGE_REGISTRATION_OFF)
        except DeviceError:
            self.disconnect()
            raise
        info = self._device.get_device_info()
        return f"{info.vendor.decode()} {info.name.decode()}".strip()

    def serial(self) -> str:
        """Returns the serial number of the open device; empty if it reports none."""
        number = self._openni.c_api.ONI_DEVICE_PROPERTY_SERIAL_NUMBER
        with contextlib.suppress(Exception):
            return self._device.get_property(number, SerialNumber).value.decode("ascii").strip()
        return ""

    def read(self, timeout: float) -> OpenniFrame | None:
        """Returns the next image of either stream, or None after `timeout` [s]; raises DeviceError if the device is
        lost."""
        names, streams = list(self._streams), list(self._streams.values())
        try:
            ready = self._openni.wait_for_any_stream(streams, timeout)
            if ready is None:
                return None
            name = names[streams.index(ready)]
            frame = ready.read_frame()
            try:
                return OpenniFrame(name, _image(name, frame))
            finally:
                frame.close()
        except Exception as error:
            raise DeviceError(f"The camera stopped: {_reason(error)}. Check its USB cable.") from None

    def disconnect(self) -> None:
        """Closes the streams, then the device: the library crashes in any other order. May be called twice."""
        for stream in self._streams.values():
            with contextlib.suppress(Exception):
                stream.close()
        self._streams.clear()
        if self._device is not None:
            with contextlib.suppress(Exception):
                self._device.close()
            self._device = None

    def _start(self, name: str, sensor: Any, pixels: Any) -> None:
        size, rate = (self._models[name].width, self._models[name].height), self._config.rate
        try:
            stream = self._device.create_stream(sensor)
            self._streams[name] = stream
            mode = stream.get_video_mode()
            # Some drivers refuse a mode that is already set.
            if (mode.resolutionX, mode.resolutionY, mode.fps, mode.pixelFormat) != (*size, rate, pixels):
                stream.configure_mode(*size, rate, pixels)
            if stream.is_property_supported(self._openni.c_api.ONI_STREAM_PROPERTY_MIRRORING):
                stream.set_mirroring_enabled(False)
            if name == "rgb" and stream.camera is not None:
                stream.camera.set_auto_exposure(self._config.auto_exposure)
                stream.camera.set_auto_white_balance(self._config.auto_white_balance)
            stream.start()
        except Exception as error:
            what = f"{size[0]} x {size[1]} at {rate} Hz"
            fault = f"The camera gives no {name} images of {what}: {_reason(error)}. Change rate or size."
            raise DeviceError(fault) from None


def _library() -> ModuleType:
    try:
        from openni import openni2
    except ImportError:
        raise DeviceError("The Python package openni is not installed: pip install openni==2.3.0.") from None
    try:
        openni2.initialize(list(FOLDERS))
    except Exception:
        fault = f"There is no libOpenNI2.so in {', '.join(FOLDERS)}; install the package libopenni2-dev."
        raise DeviceError(fault) from None
    atexit.unregister(openni2.unload)  # crashes with some drivers, and the process exits anyway
    return openni2


def _image(name: str, frame: Any) -> np.ndarray:
    """Returns a copy of the frame's pixels, because the library reuses its memory."""
    kind, channels = (np.uint8, 3) if name == "rgb" else (np.uint16, 1)
    row = frame.width * channels * np.dtype(kind).itemsize
    data = np.frombuffer(frame.get_buffer_as_uint8(), np.uint8)[: frame.height * frame.stride]
    pixels = np.ascontiguousarray(data.reshape(frame.height, frame.stride)[:, :row]).view(kind)
    return pixels.reshape(frame.height, frame.width, channels).copy().squeeze()


def _reason(error: Exception) -> str:
    """Returns the library's message without its codes."""
    message = error.args[1] if len(error.args) > 1 else error
    text = message.decode(errors="replace") if isinstance(message, bytes) else str(message)
    return " ".join(text.split()).rstrip(".") or type(error).__name__
