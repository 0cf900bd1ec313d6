"""Registers depth to the pixels of the rectified colour camera, rectifies colour, and makes a coloured point cloud. A
depth pixel becomes a point, and the point a pixel of the rectified colour camera; where several coincide, the nearest
wins. Everything that depends on the cameras alone is computed once."""

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
    inverted, and, as do its methods, for an image without its camera's size."""

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
        Raises ValueError for another size."""
        self._check(depth.shape, self._shape, "depth")
        raw = depth.ravel()
        height, width = self._x.shape
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # of what is left out below
            u, v, z = (rays * raw for rays in self._rays)
            z += self._shift[2]
            for pixel, shift in ((u, self._shift[0]), (v, self._shift[1])):
                pixel += shift
                pixel /= z
                np.rint(pixel, out=pixel)
            inside = (raw > 0.0) & (z > 0.0) & (u >= 0.0) & (u < width) & (v >= 0.0) & (v < height)
            place = v.astype(np.intp)
            place *= width
            place += u.astype(np.intp)
        np.putmask(place, ~inside, height * width)  # a place beside the image
        registered = np.full(height * width + 1, np.nan, np.float32)
        registered[place] = z
        nearer = np.flatnonzero((z < registered[place]) & inside)  # than the one written last
        while nearer.size:
            registered[place[nearer]] = z[nearer]
            nearer = nearer[z[nearer] < registered[place[nearer]]]
        return registered[:-1].reshape(height, width)

    def unrectified(self, registered: np.ndarray) -> np.ndarray:
        """Returns registered depth in the pixels of the raw colour image, same shape and unit."""
        return cv2.remap(registered, *self._raw_maps, cv2.INTER_NEAREST, borderValue=(np.nan,))

    def cloud(self, registered: np.ndarray, rectified: np.ndarray) -> np.ndarray:
        """Returns the points, shape (height, width), type POINT, in the rectified colour camera's frame, from the
        results of `register` and, in RGB, of `rectify`."""
        rgb = cv2.cvtColor(rectified, cv2.COLOR_RGB2BGRA).view(np.int32)
        rgb &= 0x00FFFFFF
        coordinates = (self._x * registered, self._y * registered, registered)
        return cv2.merge([*(c.view(np.int32) for c in coordinates), rgb]).view(POINT)[..., 0]

    @staticmethod
    def _check(shape: tuple[int, ...], wanted: tuple[int, ...], name: str) -> None:
        if shape != wanted:
            raise ValueError(f"the {name} image is {shape[::-1]}, but its camera_info says {wanted[::-1]}")


def millimetres_from_metres(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image in metres as uint16 millimetres; unknown depth and depth beyond uint16 are 0."""
    millimetres = depth * np.float32(1000.0)
    np.putmask(millimetres, ~((millimetres >= 0.0) & (millimetres <= 65535.0)), np.float32(0.0))
    return np.rint(millimetres, out=millimetres).astype(np.uint16)
