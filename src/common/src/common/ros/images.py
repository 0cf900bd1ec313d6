"""Between camera messages and arrays, without a copy where the message allows it, and the topics of an RGB-D camera."""

from __future__ import annotations

import copy
from typing import Callable

import numpy as np
import rospy
from sensor_msgs.msg import CameraInfo, Image

from common.camera_model import PLUMB_BOB, RATIONAL, CameraModel, distortion, pinhole
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL, frame_name
from common.plausible import OFF_CENTRE, OFF_CENTRE_RECTIFIED, check_intrinsics, plausible_depth
from common.poses import read_only

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


def camera_model_from_info(
    message: CameraInfo, size: tuple[int, int] | None = None, rectified: bool = False
) -> CameraModel:
    """Returns the camera of a message as image_geometry of ROS takes it: without R it is not turned, without P not
    rectified, and binning and region of interest change size and matrices. `size` is (width, height) of an image of
    this camera, which then has that size where the message says none. Of `rectified` images, P alone counts. Raises
    ValueError without a calibration, for another distortion model, or for an image of another size."""
    K, R, P = np.reshape(message.K, (3, 3)), np.reshape(message.R, (3, 3)), np.reshape(message.P, (3, 4))
    if not all(np.all(np.isfinite(matrix)) for matrix in (K, R, P)):
        raise ValueError("the numbers of the camera_info are not finite")
    P = P if P.any() else np.column_stack((K, np.zeros(3)))
    R = R if R.any() else np.eye(3)
    for name, matrix in (("P", P),) if rectified else (("K", K), ("P", P)):
        if not (matrix[0, 0] > 0.0 and matrix[1, 1] > 0.0):
            focal = f"the focal lengths in {name} of its camera_info are {matrix[0, 0]:g} and {matrix[1, 1]:g}"
            raise ValueError(f"the camera is not calibrated: {focal}; give its driver a calibration file")
        if not np.array_equal(matrix[2, :3], (0.0, 0.0, 1.0)):
            raise ValueError(f"the last row of {name} in the camera_info is {matrix[2].tolist()}, not 0, 0, 1")
    if not rectified and not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0.0):
        raise ValueError(f"R in the camera_info is {R.tolist()}, which is no rotation")
    roi = message.roi
    binning = np.maximum((message.binning_x, message.binning_y), 1)
    described = np.array((roi.width or message.width, roi.height or message.height)) // binning
    outside = roi.x_offset + roi.width > message.width or roi.y_offset + roi.height > message.height
    if message.width and message.height and (outside or not described.all()):
        raise ValueError("binning and region of interest in the camera_info leave nothing of its image")
    cut = np.array([[1.0, 0.0, -roi.x_offset], [0.0, 1.0, -roi.y_offset], [0.0, 0.0, 1.0]])
    cut[:2] /= binning[:, None]
    width, height = (own or given for own, given in zip(described.tolist(), size or (0, 0)))
    if size not in (None, (width, height)):
        sizes = f"the image is {size[0]} x {size[1]}, but its camera_info says {width} x {height}"
        raise ValueError(f"{sizes}: use the camera_info of this image topic")
    _check_size(message, {"P": P} if rectified else {"K": K, "P": P}, size)
    name = frame_name(message.header.frame_id)
    if rectified:
        return pinhole(name, width, height, (cut @ P)[:, :3])
    D = distortion(message.distortion_model, message.D)
    return CameraModel(name, width, height, *map(read_only, (cut @ K, D, R, cut @ P)))


def _check_size(message: CameraInfo, matrices: dict[str, np.ndarray], size: tuple[int, int] | None) -> None:
    """Raises ValueError if a matrix cannot be of the whole image, whose part of that `size` was taken."""
    if size is not None and not (message.width or message.roi.width):
        width, height = size[0] * max(message.binning_x, 1), size[1] * max(message.binning_y, 1)
    else:
        width, height = message.width, message.height
    for name, matrix in matrices.items() if width and height else ():
        try:
            check_intrinsics(matrix, width, height, OFF_CENTRE if name == "K" else OFF_CENTRE_RECTIFIED)
        except ValueError as error:
            raise ValueError(f"{name} in the camera_info: {error}") from None


def same_camera(a: CameraModel, b: CameraModel) -> bool:
    """Returns whether two cameras have the same size and numbers."""
    return all(np.array_equal(getattr(a, name), getattr(b, name)) for name in ("width", "height", "K", "D", "R", "P"))


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
