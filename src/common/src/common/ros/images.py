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
"""Encodings that are understood: type of an element, elements in a pixel."""


def image_message(picture: np.ndarray, encoding: str, frame: str, stamp: rospy.Time) -> Image:
    """Returns the message of a picture, shape (height, width) or (height, width, channels).

    Raises:
        ValueError: the array does not have the encoding's type and channels.
    """
    kind, channels = TYPES[encoding]
    if picture.dtype != kind or picture.shape[2:] != ((channels,) if channels > 1 else ()):
        raise ValueError(f"an array of {picture.dtype}, shape {picture.shape}, is no picture with encoding {encoding}")
    height, width = picture.shape[:2]
    message = Image(height=height, width=width, encoding=encoding, step=width * channels * kind.itemsize)
    message.header.frame_id = frame
    message.header.stamp = stamp
    message.is_bigendian = picture.dtype.byteorder == ">"
    message.data = picture.tobytes()
    return message


def picture_from_image(message: Image) -> np.ndarray:
    """Returns the picture in a message: a read-only view of its data, shape (height, width[, channels]).

    Raises:
        ValueError: the encoding is not understood, or the data do not fill the size that the message states.
    """
    if message.encoding not in TYPES:
        raise ValueError(f"the encoding {message.encoding!r} is not understood; known are {', '.join(TYPES)}")
    kind, channels = TYPES[message.encoding]
    row = message.width * channels * kind.itemsize
    if message.width == 0 or message.height == 0 or message.step < row:
        raise ValueError(f"a picture of {message.width} x {message.height} has no rows of {message.step} bytes")
    if len(message.data) != message.step * message.height:
        raise ValueError(f"a picture has {len(message.data)} bytes instead of {message.step} x {message.height}")
    rows = np.frombuffer(message.data, dtype=np.uint8).reshape(message.height, message.step)[:, :row]
    picture = rows.view(kind.newbyteorder(">" if message.is_bigendian else "<"))
    picture = picture.reshape(message.height, message.width, channels) if channels > 1 else picture
    return picture.astype(kind, copy=False)


def metres_from_millimetres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth picture of whole millimetres, 0 = none, as float32 in metres, NaN = none (REP 118)."""
    metres = depth * np.float32(0.001)
    metres[depth == 0] = np.nan
    return metres


def colour_from_image(message: Image) -> np.ndarray:
    """Returns the colour picture in a message, shape (height, width, 3), red first.

    Raises:
        ValueError: the message holds none, or is torn.
    """
    if message.encoding not in ("rgb8", "bgr8"):
        raise ValueError(f"the colour picture has the encoding {message.encoding}, not rgb8 or bgr8")
    picture = picture_from_image(message)
    return picture if message.encoding == "rgb8" else picture[..., ::-1]


def depth_from_image(message: Image) -> np.ndarray:
    """Returns the depth picture in a message, shape (height, width), float32 [m], not finite = none.

    Raises:
        ValueError: the message holds none, or is torn.
    """
    picture = picture_from_image(message)
    if picture.dtype == np.uint16:
        return metres_from_millimetres(picture)
    if picture.dtype == np.float32:
        return picture
    raise ValueError(f"the depth picture has the encoding {message.encoding}, not 16UC1 or 32FC1")


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
        ValueError: the message is of an uncalibrated camera, or of another distortion model.
    """
    D = np.asarray(message.D, dtype=float)
    if message.distortion_model not in (PLUMB_BOB, "") or D.shape not in ((5,), (0,)):
        raise ValueError(f"the distortion model {message.distortion_model!r} with {D.tolist()} is not {PLUMB_BOB}")
    K, P = np.reshape(message.K, (3, 3)), np.reshape(message.P, (3, 4))
    if not (np.all(np.isfinite(K)) and np.all(np.isfinite(P)) and np.all(np.isfinite(D))):
        raise ValueError("the camera's numbers are not finite")
    if not (K[0, 0] > 0.0 and K[1, 1] > 0.0 and P[0, 0] > 0.0 and P[1, 1] > 0.0):
        raise ValueError("the camera is not calibrated: its focal lengths are 0")
    return CameraModel(
        message.header.frame_id,
        message.width,
        message.height,
        read_only(K),
        read_only(D if D.size else np.zeros(5)),
        read_only(np.reshape(message.R, (3, 3))),
        read_only(P),
    )
