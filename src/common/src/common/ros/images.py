"""Between camera messages and arrays, without a copy where the message allows it."""

from __future__ import annotations

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.camera_model import PLUMB_BOB, CameraModel
from common.poses import read_only

TYPES = {
    "mono8": (np.dtype(np.uint8), 1),
    "8UC1": (np.dtype(np.uint8), 1),
    "rgb8": (np.dtype(np.uint8), 3),
    "bgr8": (np.dtype(np.uint8), 3),
    "mono16": (np.dtype(np.uint16), 1),
    "16UC1": (np.dtype(np.uint16), 1),
    "32FC1": (np.dtype(np.float32), 1),
}
"""Supported encodings: type of an element, elements per pixel."""


def image_message(array: np.ndarray, encoding: str, frame: str, stamp: rospy.Time) -> Image:
    """Returns the message of an image, shape (height, width) or (height, width, channels).

    Raises:
        ValueError: the array does not have the encoding's type and channels.
    """
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
    """Returns the image in a message: a read-only view of its data, shape (height, width[, channels]).

    Raises:
        ValueError: unknown encoding, or the data do not have the stated size.
    """
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
    """Returns the colour image in a message, shape (height, width, 3), red first.

    Raises:
        ValueError: another encoding, or incomplete data.
    """
    if message.encoding not in ("rgb8", "bgr8"):
        raise ValueError(f"the colour image has the encoding {message.encoding}, not rgb8 or bgr8")
    array = array_from_image(message)
    return array if message.encoding == "rgb8" else array[..., ::-1]


def depth_from_image(message: Image) -> np.ndarray:
    """Returns the depth image in a message, shape (height, width), float32 [m], not finite = none.

    Raises:
        ValueError: another encoding, or incomplete data.
    """
    array = array_from_image(message)
    if array.dtype == np.uint16:
        return metres_from_millimetres(array)
    if array.dtype == np.float32:
        return array
    raise ValueError(f"the depth image has the encoding {message.encoding}, not 16UC1 or 32FC1")


def camera_info_message(model: CameraModel, frame: str, stamp: rospy.Time) -> CameraInfo:
    """Returns the message that describes the camera."""
    message = CameraInfo(height=model.height, width=model.width, distortion_model=PLUMB_BOB)
    message.header.frame_id = frame
    message.header.stamp = stamp
    message.K, message.D = model.K.ravel().tolist(), model.D.tolist()
    message.R, message.P = model.R.ravel().tolist(), model.P.ravel().tolist()
    return message


def camera_model_from_info(message: CameraInfo) -> CameraModel:
    """Returns the camera that a message describes.

    Raises:
        ValueError: the camera is not calibrated, or has another distortion model.
    """
    D = np.asarray(message.D, dtype=float)
    if message.distortion_model not in (PLUMB_BOB, "") or D.shape not in ((5,), (0,)):
        raise ValueError(f"the distortion model {message.distortion_model!r} with {D.tolist()} is not {PLUMB_BOB}")
    K, P = np.reshape(message.K, (3, 3)), np.reshape(message.P, (3, 4))
    if not (np.all(np.isfinite(K)) and np.all(np.isfinite(P)) and np.all(np.isfinite(D))):
        raise ValueError("the numbers of the camera_info are not finite")
    if not (K[0, 0] > 0.0 and K[1, 1] > 0.0 and P[0, 0] > 0.0 and P[1, 1] > 0.0):
        raise ValueError("the camera is not calibrated: its focal lengths are 0; give its driver a calibration file")
    return CameraModel(
        message.header.frame_id,
        message.width,
        message.height,
        read_only(K),
        read_only(D if D.size else np.zeros(5)),
        read_only(np.reshape(message.R, (3, 3))),
        read_only(P),
    )
