"""Between camera messages and arrays, without a copy where the message allows it, and the topics of an RGB-D camera."""

from __future__ import annotations

import copy
from typing import Callable

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.camera_model import PLUMB_BOB, RATIONAL, CameraModel
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL
from common.plausible import plausible_depth

Outgoing = Callable[[Image], Image]

_BYTE, _WORD, _FLOAT = np.dtype(np.uint8), np.dtype(np.uint16), np.dtype(np.float32)
TYPES = {
    "mono8": (_BYTE, 1), "8UC1": (_BYTE, 1), "mono16": (_WORD, 1), "16UC1": (_WORD, 1), "32FC1": (_FLOAT, 1),
    "rgb8": (_BYTE, 3), "bgr8": (_BYTE, 3), "rgba8": (_BYTE, 4), "bgra8": (_BYTE, 4),
}  # fmt: skip
"""Supported encodings: type of an element, elements per pixel."""
COLOUR = tuple(encoding for encoding, (_, channels) in TYPES.items() if channels > 1)
RGBD_FRAMES = {"rgb": RGB_OPTICAL, "depth": DEPTH_OPTICAL, "depth_registered": RGB_OPTICAL}


def image_message(array: np.ndarray, encoding: str, frame: str, stamp: rospy.Time) -> Image:
    """Returns the message of an image, shape (height, width) or (height, width, channels); raises ValueError if the
    array does not have the encoding's type and channels."""
    kind, channels = TYPES[encoding]
    if array.dtype != kind or array.shape[2:] != ((channels,) if channels > 1 else ()):
        raise ValueError(f"an array of {array.dtype}, shape {array.shape}, does not have the encoding {encoding}")
    height, width = array.shape[:2]
    message = Image(height=height, width=width, encoding=encoding, step=width * channels * kind.itemsize)
    message.header.frame_id = frame
    message.header.stamp = stamp
    message.is_bigendian = array.dtype.byteorder == ">"
    message.data = array.tobytes()
    return message


def array_from_image(message: Image) -> np.ndarray:
    """Returns a read-only view of the image in a message, shape (height, width[, channels]); raises ValueError for an
    unknown encoding, or if the data do not have the stated size."""
    if message.encoding not in TYPES:
        raise ValueError(f"the encoding {message.encoding!r} is unknown; supported are {', '.join(TYPES)}")
    kind, channels = TYPES[message.encoding]
    row = message.width * channels * kind.itemsize
    if message.width == 0 or message.height == 0 or message.step < row:
        raise ValueError(f"an image of {message.width} x {message.height} cannot have rows of {message.step} bytes")
    if len(message.data) != message.step * message.height:
        raise ValueError(f"the image has {len(message.data)} bytes instead of {message.step} x {message.height}")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)[:, :row]
    array = rows.view(kind.newbyteorder(">" if message.is_bigendian else "<"))
    array = array.reshape(message.height, message.width, channels) if channels > 1 else array
    return array.astype(kind, copy=False)


def metres_from_millimetres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image in whole millimetres, 0 = none, as float32 in metres, NaN = none (REP 118)."""
    metres = depth * np.float32(0.001)
    metres[depth == 0] = np.nan
    return metres


def colour_from_image(message: Image) -> np.ndarray:
    """Returns the colour image in a message, shape (height, width, 3), red first; raises ValueError for another
    encoding or incomplete data."""
    if message.encoding not in COLOUR:
        raise ValueError(f"the colour image has the encoding {message.encoding}, not one of {', '.join(COLOUR)}")
    array = array_from_image(message)[..., :3]
    return array if message.encoding.startswith("rgb") else array[..., ::-1]


def depth_from_image(message: Image) -> np.ndarray:
    """Returns the depth image in a message, shape (height, width), float32 [m], not finite = none; raises ValueError
    for another encoding, incomplete data, or if it cannot be in metres."""
    array = array_from_image(message)
    if array.dtype == np.uint16:
        return plausible_depth(metres_from_millimetres(array))
    if array.dtype == np.float32:
        return plausible_depth(array)
    raise ValueError(f"the depth image has the encoding {message.encoding}, not 16UC1 or 32FC1")


def camera_info_message(model: CameraModel, frame: str, stamp: rospy.Time) -> CameraInfo:
    name = PLUMB_BOB if len(model.D) <= 5 else RATIONAL
    message = CameraInfo(height=model.height, width=model.width, distortion_model=name)
    message.header.frame_id = frame
    message.header.stamp = stamp
    message.K, message.D = model.K.ravel().tolist(), model.D.tolist()
    message.R, message.P = model.R.ravel().tolist(), model.P.ravel().tolist()
    return message


class RgbdTopics:
    """Publishes the images of an RGB-D camera, each only while it has subscribers, as openni2_camera names them:
    `rgb/image_raw` (rgb8); `depth/image_raw` (16UC1, mm, 0 = none) and `depth/image` (32FC1, m, NaN = none);
    `depth_registered/image_raw` (16UC1, in the colour camera's pixels); `camera_info` beside each of the three images.
    `rgb` and `depth` are the cameras' intrinsics; `outgoing` is applied to each image message before publication."""

    def __init__(self, rgb: CameraModel, depth: CameraModel, outgoing: Outgoing = lambda message: message) -> None:
        self._outgoing = outgoing
        models = {"rgb": rgb, "depth": depth, "depth_registered": rgb}
        self._raw = {name: rospy.Publisher(f"{name}/image_raw", Image, queue_size=1) for name in RGBD_FRAMES}
        self._metric = rospy.Publisher("depth/image", Image, queue_size=1)
        self._infos = {name: rospy.Publisher(f"{name}/camera_info", CameraInfo, queue_size=1) for name in RGBD_FRAMES}
        self._templates = {
            name: camera_info_message(models[name], frame, rospy.Time()) for name, frame in RGBD_FRAMES.items()
        }

    def wanted(self, name: str) -> bool:
        """Returns whether rgb, depth or depth_registered has subscribers."""
        metric = name == "depth" and self._metric.get_num_connections() > 0
        return metric or self._raw[name].get_num_connections() > 0

    def publish(self, name: str, image: np.ndarray, stamp: rospy.Time) -> None:
        """Publishes an image: uint8 with three channels, red first, for rgb, else uint16 [mm]."""
        encoding = "rgb8" if name == "rgb" else "16UC1"
        if self._raw[name].get_num_connections():
            self._raw[name].publish(self._outgoing(image_message(image, encoding, RGBD_FRAMES[name], stamp)))
        if name == "depth" and self._metric.get_num_connections():
            metric = image_message(metres_from_millimetres(image), "32FC1", DEPTH_OPTICAL, stamp)
            self._metric.publish(self._outgoing(metric))

    def publish_info(self, name: str, stamp: rospy.Time) -> None:
        info = copy.copy(self._templates[name])
        info.header = copy.copy(info.header)
        info.header.stamp = stamp
        self._infos[name].publish(info)

    def close(self) -> None:
        for publisher in (*self._raw.values(), self._metric, *self._infos.values()):
            publisher.unregister()
