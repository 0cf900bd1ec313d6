"""From one depth image after the other to grasps that may be told: view, network, tracking, approach, limits.

One object goes the whole way, so that a test needs no ROS. What it finds is in the camera's optical frame and, where
the camera's place is known, in kuka/base_frame. No grasp is an answer too, with its reason.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from common.camera_model import CameraModel
from common.poses import inverse, read_only
from grasping.network.maps import Maps, Peak, Smoothing, peaks, smoothed
from grasping.network.refinement import RefinedMaps
from grasping.pipeline.limits import LimitsConfig, objection
from grasping.pipeline.predictor import Predictor
from grasping.pipeline.preference import preferred
from grasping.pipeline.projection import CameraGrasp, along, grasp, pixel_size, seen_by
from grasping.pipeline.refined_grasp import Spread, opened, places, refined_grasp, spread
from grasping.pipeline.surface import NORMAL, VERTICAL, ApproachConfig, surface_at
from grasping.pipeline.tool_pose import ToolPoseConfig
from grasping.pipeline.tracking import (
    AveragingConfig,
    GraspDetection,
    GraspTracker,
    MapAverage,
    TrackedGrasp,
    TrackingConfig,
)
from grasping.pipeline.view import CameraView, GraspView, NoView, TableView

OUT_OF_SIGHT = "the best grasp is out of sight for a moment"


@dataclass(frozen=True)
class PipelineSettings:
    """How grasps are looked for.

    Attributes:
        smoothing: of the maps.
        count: most grasps.
        distance: between two peaks [px of the network's image].
        threshold: lowest quality.
        averaging, tracking, approach, limits: of each step.
        tool: the hand.
        up: the vertical in kuka/base_frame, shape (3,).
    """

    smoothing: Smoothing
    count: int
    distance: int
    threshold: float
    averaging: AveragingConfig
    tracking: TrackingConfig
    approach: ApproachConfig
    limits: LimitsConfig
    tool: ToolPoseConfig
    up: np.ndarray


class GraspProposal(NamedTuple):
    """A grasp that may be told.

    Attributes:
        id: stays while the same grasp is seen again.
        T_camera_grasp: filtered, shape (4, 4) [m].
        T_base_grasp: the same in kuka/base_frame, None where that is unknown.
        width: opening [m].
        quality: about 0 to 1, for this hand.
        angle: in the camera's image, anticlockwise [rad].
        pixel: u, v in the camera's image [px].
        width_px: opening in the camera's image [px].
        peak: in the network's image.
        spread: how the operator's grasp may differ; None without a refinement network.
    """

    id: int
    T_camera_grasp: np.ndarray
    T_base_grasp: np.ndarray | None
    width: float
    quality: float
    angle: float
    pixel: tuple[float, float]
    width_px: float
    peak: Peak
    spread: Spread | None


class PipelineResult(NamedTuple):
    """What one depth image showed.

    Attributes:
        view: what the network saw, None where there was nothing to see.
        maps: smoothed, with the quality for this hand; None likewise.
        proposals: the best first.
        reason: why there is none, a clause; empty if there is one.
        normals_missing: proposals whose surface has no clear normal; they keep the view's axis.
        seconds: how long each stage took [s].
    """

    view: GraspView | None
    maps: Maps | None
    proposals: tuple[GraspProposal, ...]
    reason: str
    normals_missing: int
    seconds: Mapping[str, float]


class GraspPipeline:
    """Looks for grasps in a stream of depth images.

    Args:
        views: makes the network's image.
        predictor: the networks.
        settings: of all steps behind them.
        clock: tells the time [s], to see how long each stage takes.
    """

    def __init__(
        self,
        views: CameraView | TableView,
        predictor: Predictor,
        settings: PipelineSettings,
        clock: Callable[[], float],
    ) -> None:
        self._views, self._predictor, self._settings, self._clock = views, predictor, settings, clock
        self._average = MapAverage(settings.averaging)
        self._tracker = GraspTracker(settings.tracking)
        self._in_base: bool | None = None
        self._last = -np.inf

    def reset(self) -> None:
        """Forgets all images."""
        self._last = -np.inf
        self._views.reset()
        self._average.reset()
        self._tracker.reset()

    def step(
        self, depth: np.ndarray, camera: CameraModel, T_base_camera: np.ndarray | None, now: float
    ) -> PipelineResult:
        """Returns the grasps in the newest image.

        Args:
            depth: shape (h, w), float32 [m], not finite = no reading.
            camera: that took it.
            T_base_camera: where it stood, shape (4, 4) [m]; None where that is unknown.
            now: stamp of the image [s].
        """
        stages = _Stages(self._clock)
        if now < self._last:  # a recording that begins again
            self.reset()
        self._last = now
        if (T_base_camera is not None) != self._in_base:
            self._in_base = T_base_camera is not None
            self._tracker.reset()
        try:
            view = self._views.step(depth, camera)
        except NoView as error:
            self._tracker.step((), now)
            return PipelineResult(None, None, (), str(error), 0, stages.end("view"))
        stages.end("view")
        output = self._predictor.output(view.image)
        stages.end("network")
        if not np.isfinite(output).all():
            return PipelineResult(view, None, (), "the network's maps are not finite", 0, stages.seconds)
        output, _ = self._average.step(output, view.image.depth)
        refined = self._predictor.refined(output, view.image)
        s = self._settings
        maps = maps_of(output if refined is None else refined.output, view, s)
        found = peaks(maps, s.count, s.distance, s.threshold)
        stages.end("peaks")
        candidates = self._candidates(found, view, refined, T_base_camera)
        told = [c for c in candidates if not c.objection]
        T_track = np.eye(4) if T_base_camera is None else T_base_camera
        detections = [GraspDetection(T_track @ c.T_camera_grasp, c.width, c.peak.quality) for c in told]
        proposals = tuple(
            _proposal(t, told[t.detection], camera, T_base_camera) for t in self._tracker.step(detections, now)
        )
        stages.end("poses")
        missing = sum(c.no_normal for c in told)
        return PipelineResult(view, maps, proposals, self._reason(candidates, proposals), missing, stages.seconds)

    def _candidates(
        self, found: list[Peak], view: GraspView, refined: RefinedMaps | None, T_base_camera: np.ndarray | None
    ) -> list[_Candidate]:
        s = self._settings
        candidates: list[_Candidate] = []
        side = len(view.image.input)
        place = None if refined is None else places(refined)
        for peak in found:
            if refined is not None:
                peak = opened(peak, refined)
            peak = peak._replace(width=max(0.0, peak.width))
            seen = grasp(peak, view.image.crop, side, view.depth, view.camera)
            if seen is None:
                candidates.append(_Candidate(peak, np.eye(4), 0.0, False, "there is no reading near it", None))
                continue
            turned, no_normal, why = (
                self._approached(seen, view, T_base_camera)
                if refined is None
                else (refined_grasp(seen, refined, peak), False, "")
            )
            if turned is None:
                candidates.append(_Candidate(peak, np.eye(4), 0.0, no_normal, why, None))
                continue
            T = view.T_camera_view @ turned.T_camera_grasp
            T_base = None if T_base_camera is None else T_base_camera @ T
            why = objection(T, T_base, turned.width, s.tool.max_opening, s.limits)
            sure = None
            if refined is not None and place is not None:
                pixel_m = view.image.crop.side / side * seen.T_camera_grasp[2, 3] / view.camera.K[0, 0]
                sure = spread(refined, place, peak, seen, pixel_m)
            candidates.append(_Candidate(peak, T, turned.width, no_normal, why, sure))
        return candidates

    def _approached(
        self, seen: CameraGrasp, view: GraspView, T_base_camera: np.ndarray | None
    ) -> tuple[CameraGrasp | None, bool, str]:
        """Returns the grasp with its approach, whether the normal is missing, and why there is no grasp."""
        c = self._settings.approach
        if c.kind == NORMAL:
            z = seen.T_camera_grasp[2, 3]
            surface = surface_at(view.depth, view.rays, seen.pixel, z, view.camera.K[0, 0], c)
            turned = None if surface.normal is None else along(seen, surface.normal, view.camera)
            return (seen, True, "") if turned is None else (turned, False, "")
        if c.kind == VERTICAL:
            if T_base_camera is None:
                return None, False, "the vertical is unknown: tf has no way from the camera to kuka/base_frame"
            down = inverse(T_base_camera @ view.T_camera_view)[:3, :3] @ -self._settings.up
            return along(seen, down, view.camera), False, "the camera looks at it too flatly for a vertical approach"
        return seen, False, ""

    def _reason(self, candidates: list[_Candidate], proposals: tuple[GraspProposal, ...]) -> str:
        if proposals:
            return ""
        if not candidates:
            return f"no peak of the quality is above {self._settings.threshold:.2f}"
        if all(c.objection for c in candidates):
            return f"the best grasp is not told: {candidates[0].objection}"
        return OUT_OF_SIGHT


def maps_of(output: np.ndarray, view: GraspView, settings: PipelineSettings) -> Maps:
    """Returns the maps in which peaks are looked for: smoothed, and with what the hand prefers.

    Args:
        output: of the networks, shape (4, h, w).
        view: what they saw.
        settings: smoothing, threshold and hand.
    """
    maps = smoothed(output, view.graspable, settings.smoothing)
    return preferred(maps, pixel_size(view.image, view.camera), settings.tool, settings.threshold)


class _Candidate(NamedTuple):
    peak: Peak
    T_camera_grasp: np.ndarray
    width: float
    no_normal: bool
    objection: str
    spread: Spread | None


def _proposal(
    tracked: TrackedGrasp, seen: _Candidate, camera: CameraModel, T_base_camera: np.ndarray | None
) -> GraspProposal:
    T_base = None if T_base_camera is None else tracked.T
    T_camera = tracked.T if T_base_camera is None else read_only(inverse(T_base_camera) @ tracked.T)
    angle, pixel, width_px = seen_by(camera, T_camera, tracked.width)
    peak = seen.peak
    return GraspProposal(
        tracked.id, T_camera, T_base, tracked.width, peak.quality, angle, pixel, width_px, peak, seen.spread
    )


class _Stages:
    """How long each stage took."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._since = clock, clock()
        self.seconds: dict[str, float] = {}

    def end(self, stage: str) -> dict[str, float]:
        """Notes the end of a stage, which is the beginning of the next."""
        now = self._clock()
        self.seconds[stage], self._since = now - self._since, now
        return self.seconds
