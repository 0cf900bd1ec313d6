"""Plans the views of a calibration from a guess of the camera pose. Random poses of the marker board in the camera
image are tried: wholly in the image, tilted, within the arm's reach, not hidden by the arm, and clear of table, arm,
camera and an upright second arm. From these, views are chosen greedily so that each gives the greatest determinant of
the Fisher information. The collision shapes are rough: the arm is a chain of capsules, the hand another capsule, the
marker board a grid of points, a second arm a column."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import ArrayLike

from apriltag_ros.tag_pose import covariance
from common.camera_model import CameraModel
from common.config import integer, number, vector
from common.poses import inverse, pose, read_only
from common.rotations import rotation_about, unit
from vision.calibration.arm_model import ArmModel
from vision.calibration.hand_eye import information
from vision.marker_board.board import MarkerBoardConfig

ARM_RADIUS_M = 0.075
HAND_RADIUS_M = 0.06
OTHER_ARM_RADIUS_M = 0.2  # of an upright second arm with an open hand
EDGE_PX = 25.0  # distance of the marker board from the edges of the image
PATH_STEP_RAD = np.radians(4.0)


@dataclass(frozen=True)
class ViewsConfig:
    """The schema of calibration_views.yaml."""

    count: int = integer(low=4, high=40, doc="number of views")
    tries: int = integer(low=100, high=20000, doc="number of random board poses that are tried")
    tilt: np.ndarray = vector(2, "deg", low=0.0, high=70.0, doc="range of the tilt of the board against the image")
    distance: np.ndarray = vector(2, "m", above=0.2, high=3.0, doc="range of the distance from the camera")
    min_height: float = number("m", low=-2.0, high=2.0, doc="minimum height of all parts over the arm's base")
    guess_position: np.ndarray = vector(3, "m", low=-5.0, high=5.0, doc="rough camera position over the base")
    guess_target: np.ndarray = vector(3, "m", low=-5.0, high=5.0, doc="rough position of the image centre")
    start: np.ndarray = vector(7, "deg", low=-175.0, high=175.0, doc="joints from which the views are reached")
    other_arm: np.ndarray | None = vector(
        2, "m", low=-5.0, high=5.0, doc="where a second arm stands upright, over the arm's base", absent=None
    )

    def faults(self) -> list[str]:
        """Returns empty ranges, and a guess without a viewing direction."""
        ranges = (("tilt", self.tilt), ("distance", self.distance))
        rule = "but the first value must be smaller than the second."
        faults = [f"{key} is {ends.tolist()}, {rule}" for key, ends in ranges if ends[0] >= ends[1]]
        if np.linalg.norm(np.cross(self.guess_target - self.guess_position, (0.0, 0.0, 1.0))) < 1e-3:
            faults.append("guess_target is straight above or below guess_position; shift it by some millimetres.")
        return faults


def guessed_camera(config: ViewsConfig, R_world_base: np.ndarray) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), of a level camera at the guessed position. The guess is given in the upright
    world, in which the base has the orientation R_world_base, shape (3, 3)."""
    forward = unit(config.guess_target - config.guess_position)
    right = unit(np.cross(forward, (0.0, 0.0, 1.0)))
    R = np.column_stack((right, np.cross(forward, right), forward))
    return pose(R_world_base.T) @ pose(R, config.guess_position)


class ViewPlanner:
    """Finds the views, as joints of the arm, shape (7,) [rad], and paths between them: joints to visit in turn.
    `points`: corners of the tags on the `board`, which is given by its drawing, shape (n, 3) [m]; `R_world_base`:
    orientation of the base in the upright world, shape (3, 3)."""

    def __init__(
        self,
        config: ViewsConfig,
        arm: ArmModel,
        camera: CameraModel,
        points: np.ndarray,
        board: MarkerBoardConfig,
        R_world_base: np.ndarray,
    ) -> None:
        grid = 5
        self._config, self._arm, self._camera, self._points = config, arm, camera, points
        self._T_flange_board, self._R_world_base, self._up = board.T_flange_tag, R_world_base, R_world_base[2]
        self._start = np.radians(config.start)
        side = np.linspace(-board.plate / 2.0, board.plate / 2.0, grid)
        self._plate = np.array([(x, y, 0.0) for x in side for y in side])

    def candidates(
        self, T_base_camera: np.ndarray, rng: np.random.Generator, centre_only: bool = False
    ) -> list[np.ndarray]:
        """Returns views in which a camera at the guessed T_base_camera, shape (4, 4) [m], should see the board.
        `centre_only` keeps the board in the image centre, where the camera sees it in spite of a bad guess."""
        found: list[np.ndarray] = []
        for _ in range(self._config.tries if not centre_only else self._config.tries // 4):
            T_base_flange = T_base_camera @ self._random_board(rng, centre_only) @ inverse(self._T_flange_board)
            distances = [float(np.linalg.norm(self._arm.flange(q)[:3] - T_base_flange[:3])) for q in found]
            nearest = found[np.argmin(distances)] if found else self._start
            for q_seed in (nearest, self._start):
                q = self._arm.joints_for(T_base_flange, q_seed)
                if q is not None and self.clearance(q, T_base_camera) > 0.0 and self.visible(q, T_base_camera):
                    found.append(read_only(q))
                    break
        return found

    def choose(self, candidates: list[np.ndarray], T_base_camera: np.ndarray) -> list[np.ndarray]:
        """Returns the most informative views, at most `count` of the configuration."""
        # information before the first view, for a determinant: standard deviations of 1/sqrt(prior) m and rad
        prior = 1e-3
        gains = [self.information(q, T_base_camera) for q in candidates]
        chosen: list[np.ndarray] = []
        total, left = prior * np.eye(12), list(range(len(candidates)))
        while left and len(chosen) < self._config.count:
            best = max(left, key=lambda i: np.linalg.slogdet(total + gains[i])[1])
            total = total + gains[best]
            left.remove(best)
            chosen.append(candidates[best])
        return chosen

    def tour(self, views: list[np.ndarray], q: ArrayLike, T_base_camera: np.ndarray) -> list[list[np.ndarray]]:
        """Returns a path to each view in turn, the first from q. The nearest view with a clear path comes next,
        directly or through the start. Views without one are left out."""
        left, legs, here = list(views), [], np.asarray(q)
        while left:
            left.sort(key=lambda view: float(np.max(np.abs(view - here))))
            tries = ([*via, view] for view in left for via in ([], [self._start]))
            path = next((path for path in tries if self._all_clear([here, *path], T_base_camera)), None)
            if path is None:
                break
            legs.append(path)
            here = path[-1]
            left = [view for view in left if view is not here]
        return legs

    def path_back(self, q: ArrayLike, legs: list[list[np.ndarray]], T_base_camera: np.ndarray) -> list[np.ndarray]:
        """Returns joints to visit from the end of the legs, which began at q, back to the start. The arm retraces its
        path until the motion to the start is clear; empty if it never is."""
        track = [np.asarray(q), *chain(*legs)][::-1]
        for i, here in enumerate(track):
            if self.path_clear(here, self._start, T_base_camera):
                return [*track[1 : i + 1], self._start]
        return []

    def path_clear(self, q: np.ndarray, goal: np.ndarray, T_base_camera: np.ndarray) -> bool:
        """Returns whether the straight joint motion from q to goal, shape (7,) [rad], is clear. Where q itself is too
        close to something, the motion must not come closer."""
        tolerance_m = 0.002
        steps = max(2, int(np.ceil(np.max(np.abs(goal - q)) / PATH_STEP_RAD)) + 1)
        least = min(0.0, self.clearance(q, T_base_camera) - tolerance_m)
        path = (q + part * (goal - q) for part in np.linspace(0.0, 1.0, steps)[1:])
        return all(self.clearance(joints, T_base_camera) > least for joints in path)

    def clearance(self, q: ArrayLike, T_base_camera: np.ndarray) -> float:
        """Returns the distance of arm, hand and marker board at q from table, camera, arm and a second arm beyond the
        minimum [m]."""
        camera_clearance_m = 0.25
        spine, plate, hand = self._bodies(q)
        held = np.concatenate((plate, hand[1:]))
        low = self._config.min_height
        return min(
            np.min(spine[2:] @ self._up) - low - ARM_RADIUS_M,
            np.min(hand @ self._up) - low - HAND_RADIUS_M,
            np.min(plate @ self._up) - low,
            np.min(np.linalg.norm(np.concatenate((spine[2:], held)) - T_base_camera[:3, 3], axis=1))
            - camera_clearance_m,
            *(np.min(_distances(held, a, b)) - ARM_RADIUS_M for a, b in zip(spine[:3], spine[1:4])),
            self._beside_other_arm(spine, plate, hand),
        )

    def _beside_other_arm(self, spine: np.ndarray, plate: np.ndarray, hand: np.ndarray) -> float:
        """Returns the level distance of these points of arm, marker board and hand from a second arm beyond the minimum
        [m]; inf without one."""
        if self._config.other_arm is None:
            return np.inf
        axis = self._config.other_arm[None]
        spine, plate, hand = (points @ self._R_world_base[:2].T for points in (spine, plate, hand))
        distances = [np.min(_distances(axis, a, b)) - ARM_RADIUS_M for a, b in zip(spine, spine[1:])]
        distances.append(np.min(_distances(axis, hand[0], hand[-1])) - HAND_RADIUS_M)
        distances.append(np.min(np.linalg.norm(plate - axis, axis=1)))
        return float(min(distances)) - OTHER_ARM_RADIUS_M

    def visible(self, q: ArrayLike, T_base_camera: np.ndarray) -> bool:
        """Returns whether the whole marker board is in the image and not hidden by the arm."""
        T_base_board = self._arm.flange(q) @ self._T_flange_board
        corners = self._points @ T_base_board[:3, :3].T + T_base_board[:3, 3]
        eye = T_base_camera[:3, 3]
        local = (corners - eye) @ T_base_camera[:3, :3]
        if np.any(local[:, 2] < 0.1):
            return False
        pixels = self._camera.project(local)
        size = np.array([self._camera.width, self._camera.height]) - 1.0
        if np.any(pixels < EDGE_PX) or np.any(pixels > size - EDGE_PX):
            return False
        spine, _, hand = self._bodies(q)
        obstacles = [(a, b, ARM_RADIUS_M) for a, b in zip(spine[:3], spine[1:4])]
        obstacles.append((hand[0], hand[-1], HAND_RADIUS_M))
        lines_of_sight = (eye + part * (corners - eye) for part in np.linspace(0.3, 0.97, 8))
        return all(np.min(_distances(points, a, b)) > r for points in lines_of_sight for a, b, r in obstacles)

    def _all_clear(self, path: list[np.ndarray], T_base_camera: np.ndarray) -> bool:
        return all(self.path_clear(a, b, T_base_camera) for a, b in zip(path, path[1:]))

    def _bodies(self, q: ArrayLike) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Returns points of the arm, shape (5, 3), the marker board, shape (25, 3), and the hand, shape (4, 3)."""
        hand_length_m = 0.25
        spine, T_base_flange = self._arm.spine(q), self._arm.flange(q)
        T_base_board = T_base_flange @ self._T_flange_board
        plate = self._plate @ T_base_board[:3, :3].T + T_base_board[:3, 3]
        hand = T_base_flange[:3, 3] + np.linspace(0.0, hand_length_m, 4)[:, None] * T_base_flange[:3, 2]
        return spine, plate, hand

    def _random_board(self, rng: np.random.Generator, centre_only: bool) -> np.ndarray:
        """Returns T_camera_board, shape (4, 4)."""
        low, high = self._config.distance
        distance = rng.uniform(low, high)
        size = np.array([self._camera.width, self._camera.height])
        u, v = size * (rng.uniform(0.4, 0.6, 2) if centre_only else rng.uniform(0.15, 0.85, 2))
        ray = self._camera.rays(np.array([u, v]))
        azimuth, turn = rng.uniform(0.0, 2.0 * np.pi, 2)
        tilt = np.radians(rng.uniform(*self._config.tilt))
        z = unit(ray)
        x = unit(np.cross((0.0, 1.0, 0.0), z))
        along_ray = np.column_stack((x, np.cross(z, x), z))
        tilted = rotation_about(2, azimuth) @ rotation_about(0, tilt) @ rotation_about(2, -azimuth)
        return pose(along_ray @ tilted @ rotation_about(0, np.pi) @ rotation_about(2, turn), distance * z)

    def information(self, q: np.ndarray, T_base_camera: np.ndarray) -> np.ndarray:
        """Returns the Fisher information that a view adds to the calibration, shape (12, 12)."""
        T_base_flange = self._arm.flange(q)
        T_camera_board = inverse(T_base_camera) @ T_base_flange @ self._T_flange_board
        detection = covariance(T_camera_board, self._points, self._camera.K)
        return information(T_base_flange, self._T_flange_board, T_base_camera, detection)


def _distances(points: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Returns the distances of points, shape (n, 3), from the segment from a to b, shape (n,) [m]."""
    along = np.clip((points - a) @ (b - a) / max(float((b - a) @ (b - a)), 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - (a + along[:, None] * (b - a)), axis=1)
