"""A pinhole camera with the distortion that ROS calls plumb_bob, or its extension rational_polynomial, as
`sensor_msgs/CameraInfo` describes it. Optical frame: x right, y down, z forward. Pixel coordinates (u, v) have the
CENTRE of the first pixel at (0, 0), as in OpenCV and CameraInfo; the image reaches from -0.5 to width - 0.5. AprilTag
libraries count from the pixel's corner: their coordinates are larger by 0.5."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from common.config import as_written
from common.errors import ConfigError
from common.frames import frame_name
from common.plausible import OFF_CENTRE, OFF_CENTRE_RECTIFIED, check_intrinsics
from common.poses import read_only

PLUMB_BOB, RATIONAL = "plumb_bob", "rational_polynomial"
COEFFICIENTS = (0, 4, 5, 8, 12)  # numbers of distortion coefficients; those that are left out are 0
MODELS = (PLUMB_BOB, RATIONAL, "none", "")
"""Distortion models that are the same where only the coefficients of plumb_bob are not 0."""


@dataclass(frozen=True)
class CameraModel:
    """Intrinsics of one camera."""

    name: str  # in its calibration file
    width: int  # of the image [px]
    height: int
    K: np.ndarray  # camera matrix, shape (3, 3) [px]
    D: np.ndarray  # distortion k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 of OpenCV, or the first 5 or 8 of them
    R: np.ndarray  # rotation from the camera to the rectified camera, shape (3, 3)
    P: np.ndarray  # projection of the rectified camera, shape (3, 4) [px, and px m in the last column]

    def project(self, points: ArrayLike) -> np.ndarray:
        """Returns the pixels, shape (..., 2) [px], of points in the optical frame, shape (..., 3), z > 0 [m]."""
        points = np.asarray(points, dtype=float)
        return self._distort(points[..., :2] / points[..., 2:]) * self._focal + self.K[:2, 2]

    def rays(self, pixels: ArrayLike) -> np.ndarray:
        """Returns the directions x, y, 1, shape (..., 3), of the pixels, shape (..., 2) [px]; raises ValueError where
        the distortion is not invertible."""
        max_iterations = 50
        tolerance = 1e-10  # of the undistorted direction, at which the iteration stops
        distorted = (np.asarray(pixels, dtype=float) - self.K[:2, 2]) / self._focal
        direction = distorted
        if not self.D.any():
            return np.concatenate((direction, np.ones((*direction.shape[:-1], 1))), axis=-1)
        for _ in range(max_iterations):
            step = distorted - self._distort(direction)
            direction = direction + step
            if np.max(np.abs(step), initial=0.0) < tolerance:
                return np.concatenate((direction, np.ones((*direction.shape[:-1], 1))), axis=-1)
        raise ValueError(f"the distortion {self.D.tolist()} of {self.name} is not invertible; calibrate it again")

    @property
    def _focal(self) -> np.ndarray:
        return self.K[[0, 1], [0, 1]]

    def rectified(self) -> CameraModel:
        """Returns the camera of the rectified image: without distortion, with the matrix of P."""
        return pinhole(self.name, self.width, self.height, self.P[:, :3])

    def _distort(self, xy: np.ndarray) -> np.ndarray:
        """Returns the undistorted directions xy, shape (..., 2), after distortion (Brown-Conrady, with the additions of
        OpenCV)."""
        k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4 = np.pad(self.D, (0, COEFFICIENTS[-1] - len(self.D)))
        x, y = xy[..., 0], xy[..., 1]
        r2 = x * x + y * y
        radial = (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
        dx = 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x) + r2 * (s1 + r2 * s2)
        dy = p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y + r2 * (s3 + r2 * s4)
        return np.stack((x * radial + dx, y * radial + dy), axis=-1)


def pinhole(name: str, width: int, height: int, K: ArrayLike) -> CameraModel:
    """Returns the camera without distortion with the matrix K, shape (3, 3) [px]."""
    K = read_only(K)
    P = np.column_stack((K, np.zeros(3)))
    return CameraModel(name, width, height, K, read_only(np.zeros(5)), read_only(np.eye(3)), read_only(P))


def distortion(model: object, coefficients: ArrayLike) -> np.ndarray:
    """Returns `CameraModel.D` of the coefficients that drivers and calibrations give for a `model`; raises ValueError
    if it is of another kind. plumb_bob may come with four, or with more of which the rest are 0."""
    D = np.asarray(coefficients, dtype=float).ravel()
    if not D[COEFFICIENTS[-1] :].any():  # the others are those of a tilted sensor
        D = D[: COEFFICIENTS[-1]]
    name = model.lower() if isinstance(model, str) else None
    plain = not D[5:].any()
    if name not in MODELS or len(D) not in COEFFICIENTS or not (plain or name == RATIONAL) or not np.isfinite(D).all():
        raise ValueError(
            f"the distortion model {model!r} with {D.tolist()} is neither {PLUMB_BOB} nor {RATIONAL}: calibrate the "
            "camera with one of these"
        )
    return read_only(np.append(D, np.zeros(5))[:5] if plain else D)


def camera_model_from_info(message: Any, size: tuple[int, int] | None = None, rectified: bool = False) -> CameraModel:
    """Returns the camera of a sensor_msgs/CameraInfo as image_geometry of ROS takes it: without R it is not turned,
    without P not rectified, and binning and region of interest change size and matrices. `size` is (width, height) of
    an image of this camera, which then has that size where the message says none. Of `rectified` images, P alone
    counts. Raises ValueError without a calibration, for another distortion model, or for an image of another size."""
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
    if size is not None and size != (width, height):
        sizes = f"the image is {size[0]} x {size[1]}, but its camera_info says {width} x {height}"
        raise ValueError(f"{sizes}: use the camera_info of this image topic")
    _check_size(message, {"P": P} if rectified else {"K": K, "P": P}, size)
    name = frame_name(message.header.frame_id)
    if rectified:
        return pinhole(name, width, height, (cut @ P)[:, :3])
    D = distortion(message.distortion_model, message.D)
    return CameraModel(name, width, height, *map(read_only, (cut @ K, D, R, cut @ P)))


def _check_size(message: Any, matrices: dict[str, np.ndarray], size: tuple[int, int] | None) -> None:
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


def from_calibration(values: Mapping[str, Any]) -> CameraModel:
    """Returns the camera in a yaml mapping of camera_calibration_parsers; raises ConfigError with all faults."""
    faults: list[str] = []
    if not isinstance(values, Mapping):
        raise ConfigError([f"The calibration is {values!r}, but must be a mapping."])
    # A label, which camera_calibration_parsers writes without quotes: a serial number comes as a number.
    name = str(as_written(values, "camera_name") if "camera_name" in values else "")
    if not name.strip():
        faults.append(f"camera_name is {name!r}, but must be a text.")
    for key in ("image_width", "image_height"):
        size = values.get(key)
        if isinstance(size, bool) or not isinstance(size, int) or not 0 < size <= 16384:
            faults.append(f"{key} is {size!r}, but must be a whole number of pixels.")
    K = _matrix(values, "camera_matrix", (3, 3), faults)
    D = _distortion(values, faults)
    R = _matrix(values, "rectification_matrix", (3, 3), faults)
    P = _matrix(values, "projection_matrix", (3, 4), faults)
    for key, matrix, off in (("camera_matrix", K, OFF_CENTRE), ("projection_matrix", P, OFF_CENTRE_RECTIFIED)):
        try:
            if matrix is not None and not any(fault.startswith("image_") for fault in faults):
                check_intrinsics(matrix, values["image_width"], values["image_height"], off)
        except ValueError as error:
            faults.append(f"{key}: {error}.")
    if R is not None and not R.any():  # of a driver that rectifies nothing
        R = read_only(np.eye(3))
    if R is not None and not (np.allclose(R @ R.T, np.eye(3), atol=1e-3) and np.linalg.det(R) > 0.0):
        faults.append(f"rectification_matrix is {R.tolist()}, which is no rotation.")
    if faults or K is None or D is None or R is None or P is None:
        raise ConfigError(faults)
    return CameraModel(name, values["image_width"], values["image_height"], K, D, R, P)


def _distortion(values: Mapping[str, Any], faults: list[str]) -> np.ndarray | None:
    """Returns the distortion; ROS Melodic's calibrator called its model camera_model."""
    entry = values.get("distortion_coefficients")
    model = values.get("distortion_model", values.get("camera_model"))
    try:
        return distortion(model, entry["data"])  # type: ignore[index]
    except (KeyError, TypeError):
        faults.append(f"distortion_coefficients is {entry!r}, but must have finite numbers as data.")
    except (OverflowError, ValueError) as error:
        faults.append(f"distortion_model and distortion_coefficients: {error}.")
    return None


def _matrix(values: Mapping[str, Any], key: str, shape: tuple[int, int], faults: list[str]) -> np.ndarray | None:
    entry = values.get(key)
    data = entry.get("data") if isinstance(entry, Mapping) else None
    try:
        matrix = read_only(np.asarray(data, dtype=float).reshape(shape))
        if np.all(np.isfinite(matrix)):
            return matrix
    except (TypeError, ValueError, OverflowError):
        pass
    faults.append(f"{key} is {entry!r}, but must have {shape[0]} x {shape[1]} finite numbers as data.")
    return None
