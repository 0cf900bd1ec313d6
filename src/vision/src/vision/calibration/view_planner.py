"""Where the arm holds the panel for a calibration: views chosen from a guess of where the camera is.

Random places of the panel in the camera's picture are tried: wholly in the picture, not head-on, within the arm's
reach, clear of table, arm and camera, and not behind the arm. Of those the views are chosen one
after the other, each the one that makes the calibration surest (greatest determinant of the information). The bodies
are rough: the arm is a chain of thick straight pieces, the hand another, the panel a grid of points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from apriltag_ros.tag_pose import covariance
from common.camera_model import CameraModel
from common.config import integer, number, vector
from common.poses import inverse, pose, read_only
from common.rotations import rotation_about, unit
from vision.calibration.arm_model import ArmModel
from vision.calibration.hand_eye import information

ARM_RADIUS_M = 0.075
HAND_LENGTH_M, HAND_RADIUS_M = 0.25, 0.06
CAMERA_CLEARANCE_M = 0.25
EDGE_PX = 25.0
"""The panel keeps so far from the edges of the picture."""

SEEDS, SEED_RAD = 2, np.radians(50.0)
"""So often, and so far from the start, joints for a place are looked for anew."""

GRID = 5
WAY_STEP_RAD = np.radians(4.0)
TOLERANCE_M = 0.002
PRIOR = 1e-3
"""Of what is known before the first view, so that the determinant exists: as many as 1/sqrt(PRIOR) m and rad."""


@dataclass(frozen=True)
class ViewsConfig:
    """The schema of calibration_views.yaml."""

    count: int = integer(low=4, high=40, doc="views to visit")
    tries: int = integer(low=100, high=20000, doc="random places that are looked at")
    tilt: np.ndarray = vector(2, "deg", low=0.0, high=70.0, doc="least and greatest angle between panel and picture")
    distance: np.ndarray = vector(2, "m", above=0.2, high=3.0, doc="least and greatest distance from the camera")
    min_height: float = number("m", low=-2.0, high=2.0, doc="nothing goes below this height over the arm's base")
    guess_position: np.ndarray = vector(3, "m", low=-5.0, high=5.0, doc="roughly where the camera is, over the base")
    guess_target: np.ndarray = vector(3, "m", low=-5.0, high=5.0, doc="roughly what is in the middle of its picture")
    start: np.ndarray = vector(7, "deg", low=-175.0, high=175.0, doc="joints from which the views are reached")

    def faults(self) -> list[str]:
        """Returns ranges that are empty, and a camera that looks nowhere."""
        faults = [
            f"{key} is {getattr(self, key).tolist()}, but the first must be the smaller one."
            for key in ("tilt", "distance")
            if getattr(self, key)[0] >= getattr(self, key)[1]
        ]
        if np.linalg.norm(np.cross(self.guess_target - self.guess_position, (0.0, 0.0, 1.0))) < 1e-3:
            faults.append("guess_target is straight above or below guess_position; shift it a little.")
        return faults


@dataclass(frozen=True, eq=False)
class Place:
    """The arm at a view.

    Attributes:
        q: joints, shape (7,) [rad].
        T_base_flange: shape (4, 4) [m].
    """

    q: np.ndarray
    T_base_flange: np.ndarray


@dataclass(frozen=True, eq=False)
class Leg:
    """The way to one view.

    Attributes:
        place: the view.
        way: joints to go to one after the other, each shape (7,) [rad]; the last are those of the place.
    """

    place: Place
    way: tuple[np.ndarray, ...]


def guessed_camera(config: ViewsConfig, R_world_base: np.ndarray) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), of a level camera at the guessed place.

    Args:
        R_world_base: attitude of the base in the upright world, shape (3, 3); the guess is given in that world.
    """
    ahead = unit(config.guess_target - config.guess_position)
    right = unit(np.cross(ahead, (0.0, 0.0, 1.0)))
    R = np.column_stack((right, np.cross(ahead, right), ahead))
    return pose(R_world_base.T) @ pose(R, config.guess_position)


class ViewPlanner:
    """Finds places for the panel.

    Args:
        arm: kinematics of the arm.
        camera: that is to be calibrated.
        points: corners of the panel's tags, shape (n, 3) [m].
        plate: edge of the panel's plate [m].
        T_flange_panel: by the panel's drawing, shape (4, 4) [m].
        R_world_base: attitude of the base in the upright world, shape (3, 3).
    """

    def __init__(
        self,
        config: ViewsConfig,
        arm: ArmModel,
        camera: CameraModel,
        points: np.ndarray,
        plate: float,
        T_flange_panel: np.ndarray,
        R_world_base: np.ndarray,
    ) -> None:
        self._config, self._arm, self._camera, self._points = config, arm, camera, points
        self._T_flange_panel, self._up = T_flange_panel, R_world_base[2]
        side = np.linspace(-plate / 2.0, plate / 2.0, GRID)
        self._plate = np.array([(x, y, 0.0) for x in side for y in side])

    def candidates(self, T_base_camera: np.ndarray, rng: np.random.Generator, centre_only: bool = False) -> list[Place]:
        """Returns places of the arm at which the camera should see the panel.

        Args:
            T_base_camera: guess of the camera's pose, shape (4, 4) [m].
            centre_only: the panel is in the middle of the picture, where it is seen with a bad guess too.
        """
        start = np.radians(self._config.start)
        found: list[Place] = []
        for _ in range(self._config.tries if not centre_only else self._config.tries // 4):
            T_base_flange = T_base_camera @ self._random_view(rng, centre_only) @ inverse(self._T_flange_panel)
            near = min(
                (place.q for place in found), key=lambda q: _far(self._arm.flange(q), T_base_flange), default=start
            )
            for seed in (near, start):
                q = self._arm.joints_for(T_base_flange, seed)
                if q is not None and self.clearance(q, T_base_camera) > 0.0 and self.seen(q, T_base_camera):
                    found.append(Place(read_only(q), read_only(self._arm.flange(q))))
                    break
        return found

    def choose(self, candidates: list[Place], T_base_camera: np.ndarray) -> list[Place]:
        """Returns the places that together make the calibration surest, at most as many as the configuration says."""
        gains = [self._information(place, T_base_camera) for place in candidates]
        chosen: list[Place] = []
        total, left = PRIOR * np.eye(12), list(range(len(candidates)))
        while left and len(chosen) < self._config.count:
            best = max(left, key=lambda i: np.linalg.slogdet(total + gains[i])[1])
            total = total + gains[best]
            left.remove(best)
            chosen.append(candidates[best])
        return chosen

    def tour(self, places: list[Place], q: ArrayLike, T_base_camera: np.ndarray) -> list[Leg]:
        """Returns the way from q, shape (7,) [rad], to the places.

        Always the nearest is next to which the way, all joints together, is clear, directly or by the start; places
        without such a way are left out.
        """
        start, left, legs, here = np.radians(self._config.start), list(places), [], np.asarray(q)
        while left:
            left.sort(key=lambda place: float(np.max(np.abs(place.q - here))))
            for place in left:
                ways = ([place.q], [start, place.q])
                way = next((way for way in ways if self._ways_clear(here, way, T_base_camera)), None)
                if way is not None:
                    legs.append(Leg(place, tuple(read_only(goal) for goal in way)))
                    left.remove(place)
                    here = place.q
                    break
            else:
                break
        return legs

    def _ways_clear(self, q: np.ndarray, way: list[np.ndarray], T_base_camera: np.ndarray) -> bool:
        return all(self.way_clear(a, b, T_base_camera) for a, b in zip([q, *way[:-1]], way))

    def way_back(self, q: ArrayLike, legs: list[Leg], T_base_camera: np.ndarray) -> list[np.ndarray]:
        """Returns joints to go to one after the other from the end of the legs, which began at q, back to the start.

        It goes back on its own track until the way to the start is clear; empty if that never is.
        """
        start = np.radians(self._config.start)
        track = [np.asarray(q), *(goal for leg in legs for goal in leg.way)]
        for i, here in enumerate(track[::-1]):
            if self.way_clear(here, start, T_base_camera):
                return [*track[::-1][1 : i + 1], start]
        return []

    def way_clear(self, q: np.ndarray, goal: np.ndarray, T_base_camera: np.ndarray) -> bool:
        """Returns whether the arm can go from q to goal, shape (7,) [rad], with all joints together.

        Where it comes too near to something at q already, it may not come nearer.
        """
        steps = max(2, int(np.ceil(np.max(np.abs(goal - q)) / WAY_STEP_RAD)) + 1)
        least = min(0.0, self.clearance(q, T_base_camera) - TOLERANCE_M)
        way = (q + part * (goal - q) for part in np.linspace(0.0, 1.0, steps)[1:])
        return all(self.clearance(joints, T_base_camera) > least for joints in way)

    def clearance(self, q: ArrayLike, T_base_camera: np.ndarray) -> float:
        """Returns how far arm, hand and panel at q are from table, camera and arm, less what they should be [m]."""
        spine, plate, hand = self._bodies(q)
        held = np.concatenate((plate, hand[1:]))
        low = self._config.min_height
        return min(
            np.min(spine[2:] @ self._up) - low - ARM_RADIUS_M,
            np.min(hand @ self._up) - low - HAND_RADIUS_M,
            np.min(plate @ self._up) - low,
            np.min(np.linalg.norm(np.concatenate((spine[2:], held)) - T_base_camera[:3, 3], axis=1))
            - CAMERA_CLEARANCE_M,
            *(np.min(_distances(held, a, b)) - ARM_RADIUS_M for a, b in zip(spine[:3], spine[1:4])),
        )

    def seen(self, q: ArrayLike, T_base_camera: np.ndarray) -> bool:
        """Returns whether the whole panel is in the picture, and the arm not before it."""
        T_base_panel = self._arm.flange(q) @ self._T_flange_panel
        corners = self._points @ T_base_panel[:3, :3].T + T_base_panel[:3, 3]
        local = (corners - T_base_camera[:3, 3]) @ T_base_camera[:3, :3]
        if np.any(local[:, 2] < 0.1):
            return False
        pixels = self._camera.project(local)
        size = np.array([self._camera.width, self._camera.height]) - 1.0
        if np.any(pixels < EDGE_PX) or np.any(pixels > size - EDGE_PX):
            return False
        spine, _, hand = self._bodies(q)
        eye = T_base_camera[:3, 3]
        sight = (eye + part * (corners - eye) for part in np.linspace(0.3, 0.97, 8))
        return all(
            np.min(_distances(points, a, b)) > radius
            for points in sight
            for a, b, radius in (
                *((a, b, ARM_RADIUS_M) for a, b in zip(spine[:3], spine[1:4])),
                (hand[0], hand[-1], HAND_RADIUS_M),
            )
        )

    def _bodies(self, q: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        spine, T_base_flange = self._arm.spine(q), self._arm.flange(q)
        T_base_panel = T_base_flange @ self._T_flange_panel
        plate = self._plate @ T_base_panel[:3, :3].T + T_base_panel[:3, 3]
        hand = T_base_flange[:3, 3] + np.linspace(0.0, HAND_LENGTH_M, 4)[:, None] * T_base_flange[:3, 2]
        return spine, plate, hand

    def _random_view(self, rng: np.random.Generator, centre_only: bool) -> np.ndarray:
        """Returns T_camera_panel, shape (4, 4)."""
        low, high = self._config.distance
        distance = rng.uniform(low, high)
        size = np.array([self._camera.width, self._camera.height])
        u, v = size * (rng.uniform(0.4, 0.6, 2) if centre_only else rng.uniform(0.15, 0.85, 2))
        ray = self._camera.rays(np.array([u, v]))
        azimuth, turn = rng.uniform(0.0, 2.0 * np.pi, 2)
        tilt = np.radians(rng.uniform(*self._config.tilt))
        towards = rotation_about(2, azimuth) @ rotation_about(0, tilt) @ rotation_about(2, -azimuth)
        return pose(_facing(ray) @ towards @ rotation_about(0, np.pi) @ rotation_about(2, turn), distance * unit(ray))

    def _information(self, place: Place, T_base_camera: np.ndarray) -> np.ndarray:
        T_camera_panel = inverse(T_base_camera) @ place.T_base_flange @ self._T_flange_panel
        seen = covariance(T_camera_panel, self._points, self._camera.K)
        return information(place.T_base_flange, self._T_flange_panel, T_base_camera, seen)


def _facing(ray: np.ndarray) -> np.ndarray:
    """Returns a rotation whose z axis is along the ray, and whose x axis is level in the picture."""
    z = unit(ray)
    x = unit(np.cross((0.0, 1.0, 0.0), z))
    return np.column_stack((x, np.cross(z, x), z))


def _far(T: np.ndarray, other: np.ndarray) -> float:
    return float(np.linalg.norm(T[:3] - other[:3]))


def _distances(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the distances of points, shape (n, 3), from the straight piece from a to b, shape (n,) [m]."""
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - (a + along[:, None] * (b - a)), axis=1)
