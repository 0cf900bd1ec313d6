"""Registers depth to the pixels of the rectified colour camera, rectifies colour, and makes a coloured point cloud. A
depth pixel becomes a point, and the point a pixel of the rectified colour camera; where several coincide, the nearest
wins. Everything that depends on the cameras alone is computed once.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from common.camera_model import CameraModel
from common.config import number

POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("rgb", "<u4")])  # of a cloud: metres, and 0x00RRGGBB


@dataclass(frozen=True)
class PairsConfig:
    """Private parameters of the nodes register_rgbd and plane_pose, which pair images."""

    slop: float = number("s", low=0.0, high=1.0, doc="maximum time between colour and depth image", absent=0.04)


class Registration:
    """Registers the images of a colour camera with a depth camera at T_rgb_depth, shape (4, 4) [m]; both images are
    raw. All results belong to `camera`, the rectified colour camera. Raises ValueError if a distortion cannot be
    inverted, and, as do its methods, for an image without its camera's size.
    """

    def __init__(self, rgb: CameraModel, depth: CameraModel, T_rgb_depth: np.ndarray) -> None:
        self.camera = rgb.rectified()
        K = self.camera.K
        pixels = np.stack(np.meshgrid(np.arange(depth.width), np.arange(depth.height)), axis=-1)
        # Rays in the rectified camera's axes, multiplied by K: an image then takes one product and one division.
        KR = K @ rgb.R
        self._rays = (depth.rays(pixels) @ (KR @ T_rgb_depth[:3, :3]).T).reshape(-1, 3).T.astype(np.float32)
        self._shift = (KR @ T_rgb_depth[:3, 3]).astype(np.float32)
        self._shape = (depth.height, depth.width)
        self._maps = cv2.initUndistortRectifyMap(rgb.K, rgb.D, rgb.R, K, (rgb.width, rgb.height), cv2.CV_16SC2)
        u, v = np.meshgrid(np.arange(rgb.width), np.arange(rgb.height))
        self._x = ((u - K[0, 2]) / K[0, 0]).astype(np.float32)
        self._y = ((v - K[1, 2]) / K[1, 1]).astype(np.float32)
        raw = self.camera.project(rgb.rays(np.stack((u, v), axis=-1)) @ rgb.R.T).astype(np.float32)
        self._raw_maps = cv2.convertMaps(raw[..., 0], raw[..., 1], cv2.CV_16SC2, nninterpolation=True)

    def rectify(self, colour: np.ndarray) -> np.ndarray:
        """Returns the rectified colour image, shape (height, width, 3); ValueError for another size."""
        self._check(colour.shape[:2], self._x.shape, "colour")
        return cv2.remap(colour, *self._maps, cv2.INTER_LINEAR)

    def register(self, depth: np.ndarray) -> np.ndarray:
        """Returns the raw depth image in the rectified colour camera's pixels; both float32 [m], NaN where unknown.

        Raises ValueError for another size.
        """
        self._check(depth.shape, self._shape, "depth")
        z = depth.ravel()
        valid = np.flatnonzero(np.isfinite(z) & (z > 0.0))
        u, v, z = self._rays[:, valid] * z[valid] + self._shift[:, None]
        height, width = self._x.shape
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            u, v = u / z, v / z
        inside = (z > 0.0) & (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
        u, v, z = np.rint(u[inside]).astype(np.int32), np.rint(v[inside]).astype(np.int32), z[inside]
        registered = np.full(height * width, np.inf, np.float32)
        np.minimum.at(registered, np.clip(v, 0, height - 1) * width + np.clip(u, 0, width - 1), z)
        registered[np.isinf(registered)] = np.nan
        return registered.reshape(height, width)

    def unrectified(self, registered: np.ndarray) -> np.ndarray:
        """Returns registered depth in the pixels of the raw colour image, same shape and unit."""
        return cv2.remap(registered, *self._raw_maps, cv2.INTER_NEAREST, borderValue=(np.nan,))

    def cloud(self, registered: np.ndarray, rectified: np.ndarray) -> np.ndarray:
        """Returns the points, shape (height, width), type POINT, in the rectified colour camera's frame, from the
        results of `register` and, in RGB, of `rectify`.
        """
        points = np.empty(registered.shape, POINT)
        points["x"], points["y"], points["z"] = self._x * registered, self._y * registered, registered
        red, green, blue = (rectified[..., i].astype(np.uint32) for i in range(3))
        points["rgb"] = red << 16 | green << 8 | blue
        return points

    @staticmethod
    def _check(shape: tuple[int, ...], wanted: tuple[int, ...], name: str) -> None:
        if shape != wanted:
            raise ValueError(f"the {name} image is {shape[::-1]}, but its camera_info says {wanted[::-1]}")


def millimetres_from_metres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image in metres as uint16 millimetres; unknown depth and depth beyond uint16 are 0."""
    millimetres = np.nan_to_num(depth * np.float32(1000.0), nan=0.0, posinf=0.0, neginf=0.0)
    millimetres[(millimetres < 0.0) | (millimetres > 65535.0)] = 0.0
    return np.rint(millimetres).astype(np.uint16)
