"""From depth images to grasps: view, network, averaging, maxima or a network of lifts, approach, limits, tracking.

One object runs all steps, live and offline; the defaults of `PipelineSettings` are the offline use, without memory and
limits. Poses are in the camera's optical frame and, where the camera's pose is known, in kuka/base_frame.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple, Union

import numpy as np
from torch import nn

from common.camera_model import CameraModel
from common.poses import inverse, read_only
from grasping.network.maps import Maps, Peak, Smoothing, highest, peaks, smoothed
from grasping.network.networks import FLOAT32, frozen, infer
from grasping.pipeline import projection
from grasping.pipeline.lift_grasps import LiftGrasp, lift_grasps
from grasping.pipeline.tool_pose import (
    LimitsConfig,
    ToolPoseConfig,
    preferred,
    rejection_reason,
    wait_rejection_reason,
)
from grasping.pipeline.tracking import (
    AveragingConfig,
    GraspDetection,
    GraspTracker,
    MapAverage,
    TrackedGrasp,
    TrackingConfig,
)
from grasping.pipeline.view import CameraView, GraspView, NoView, TableView
from grasping.poses.chooser import ImageMaps
from grasping.poses.hypotheses import MAX_TILT_RAD
from grasping.poses.lift_network import LiftNetwork
from grasping.poses.preferred import GraspUncertainty
from grasping.poses.taste import PoseTaste

NONE_CHOSEN = np.zeros((0, 4, 4)), np.zeros(0)
LOOKED_AT = 10  # candidates for each grasp that is wanted: some are outside the limits
OUT_OF_SIGHT = "the best grasp is briefly out of sight"


@dataclass(frozen=True)
class PipelineSettings:
    """Settings of the network and of the steps behind it; None leaves a step out."""

    smoothing: Smoothing = field(default_factory=Smoothing)  # of the maps
    count: int = 1  # most grasps
    distance: int = 20  # between two peaks [px of the network's image]
    threshold: float | None = None  # lowest quality; None takes the highest pixel, whatever its quality
    averaging: AveragingConfig | None = None  # over time
    tracking: TrackingConfig | None = None  # likewise
    approach: projection.ApproachConfig | None = None  # None is along the axis of the view
    limits: LimitsConfig | None = None  # a grasp outside them is rejected
    tool: ToolPoseConfig | None = None  # the hand, with its preferred and largest opening
    up: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))  # vertical in kuka/base_frame, shape (3,)
    precision: str = FLOAT32  # of the network, in `networks.PRECISIONS`
    max_tilt: float = MAX_TILT_RAD  # of what a network of lifts chooses, from straight down onto the table [rad]


class GraspCandidate(NamedTuple):
    """A peak of the maps and the grasp there."""

    peak: Peak  # in the network's image
    grasp: projection.CameraGrasp | None  # before the view's camera; None without a reading or an approach
    normal_missing: bool  # the surface has no clear normal, and the approach is along the axis of the view instead
    rejection: str  # why the grasp is not published, a clause; empty if it is
    chosen: LiftGrasp | None = None  # by a network of lifts with its approach; the quality is the probability of a lift

    @property
    def rank(self) -> float:
        """By which candidates are ordered, about 0 to 1."""
        return self.peak.quality if self.chosen is None else self.chosen.rank


class GraspProposal(NamedTuple):
    """A grasp that may be published."""

    id: int  # stays while the same grasp is detected again
    T_camera_grasp: np.ndarray  # filtered, shape (4, 4) [m]
    T_base_grasp: np.ndarray | None  # the same in kuka/base_frame, None where that is unknown
    width: float  # opening [m]
    quality: float  # about 0 to 1, for this hand
    angle: float  # in the camera's image, anticlockwise [rad]
    pixel: tuple[float, float]  # u, v in the camera's image [px]
    width_px: float  # opening in the camera's image [px]
    peak: Peak  # in the network's image
    uncertainty: GraspUncertainty | None  # of the operator's grasp; None without a taste
    own_approach: bool  # a network of lifts chose its approach; the quality is the probability of a lift


class PipelineResult(NamedTuple):
    """The result for one depth image."""

    view: GraspView | None  # the network's input, None where there was nothing to see
    maps: Maps | None  # smoothed, with the quality for this hand; None likewise
    candidates: tuple[GraspCandidate, ...]  # one for each peak, best first
    grasps: tuple[GraspProposal, ...]  # the candidates that passed all limits, tracked, best first
    reason: str  # why there is no grasp, a clause; empty if there is one
    seconds: Mapping[str, float]  # duration of each stage [s]

    @property
    def normals_missing(self) -> int:
        """Number of accepted candidates whose surface has no clear normal."""
        return sum(c.normal_missing for c in self.candidates if not c.rejection)


class GraspPipeline:
    """Finds grasps in single depth images or in a stream of them, with GG-CNN or GG-CNN2 and, if given, what a network
    says of `lifts` and, among these, an operator prefers (`taste`). `clock` returns the time [s] by which the stages
    are timed; the default times nothing.
    """

    def __init__(
        self,
        views: CameraView | TableView,
        network: nn.Module,
        settings: PipelineSettings,
        clock: Callable[[], float] = lambda: 0.0,
        lifts: LiftNetwork | None = None,
        taste: PoseTaste | None = None,
    ) -> None:
        if taste is not None and lifts is None:
            raise ValueError("a taste needs a network of lifts")
        self._views, self._settings, self._clock, self._lifts, self._taste = views, settings, clock, lifts, taste
        self.network = frozen(network, precision=settings.precision)
        self._average = None if settings.averaging is None else MapAverage(settings.averaging)
        self._tracker = None if settings.tracking is None else GraspTracker(settings.tracking)
        self._in_base: bool | None = None
        self._last, self._chosen = -np.inf, NONE_CHOSEN

    def reset(self) -> None:
        self._last, self._chosen = -np.inf, NONE_CHOSEN
        for step in (self._views, self._average, self._tracker):
            if step is not None:
                step.reset()

    def prefer(self, taste: PoseTaste) -> None:
        """Prefers from now on what an operator prefers of another kind of object; forgets all images."""
        if self._taste is None:
            raise ValueError("a chain without a taste cannot take one")
        self._taste = taste
        self.reset()

    def step(
        self, depth: np.ndarray, camera: CameraModel, T_base_camera: np.ndarray | None = None, now: float = 0.0
    ) -> PipelineResult:
        """Returns the grasps in a depth image, shape (h, w), float32 [m], not finite = no reading, by `camera` at
        T_base_camera, shape (4, 4) [m], None if unknown; the stamp `now` [s] matters to averaging and tracking only.
        """
        stages = _StageTimes(self._clock)
        if now < self._last:  # a recording that begins again
            self.reset()
        self._last = now
        if (T_base_camera is not None) != self._in_base:
            self._in_base, self._chosen = T_base_camera is not None, NONE_CHOSEN
            if self._tracker is not None:
                self._tracker.reset()
        try:
            view = self._views.step(depth, camera)
        except NoView as error:
            self._track((), now)
            return PipelineResult(None, None, (), (), str(error), stages.end("view"))
        stages.end("view")
        output = infer(self.network, view.image.input)
        stages.end("network")
        if not np.isfinite(output).all():
            return PipelineResult(view, None, (), (), "the network's maps are not finite", stages.seconds)
        if self._average is not None:
            output, _ = self._average.step(output, view.image.depth)
        T_track_camera = np.eye(4) if T_base_camera is None else T_base_camera
        T_track_view = T_track_camera @ view.T_camera_view
        maps, found = self._peaks(output, view, T_track_view, T_base_camera)
        stages.end("peaks")
        enough = self._until_enough(self._candidates(found, view, T_base_camera))
        candidates = tuple(sorted(enough, key=lambda one: -one.rank))
        accepted = [c for c in candidates if not c.rejection]
        chosen = [c.chosen.grasp for c in candidates if c.chosen is not None]
        T = np.array([one.T_camera_grasp for one in chosen]).reshape(-1, 4, 4)
        self._chosen = T_track_view @ T, np.array([one.width for one in chosen])
        seen = [(c.grasp, c.rank) for c in accepted if c.grasp is not None]
        T_view = view.T_camera_view
        detections = [GraspDetection(T_track_camera @ (T_view @ g.T_camera_grasp), g.width, q) for g, q in seen]
        grasps = tuple(_proposal(t, accepted[t.detection], camera, T_base_camera) for t in self._track(detections, now))
        stages.end("poses")
        return PipelineResult(view, maps, candidates, grasps, self._reason(candidates, grasps), stages.seconds)

    def _track(self, detections: Sequence[GraspDetection], now: float) -> list[TrackedGrasp]:
        if self._tracker is not None:
            return self._tracker.step(detections, now)
        return [TrackedGrasp(i + 1, i, read_only(d.T), d.width, False) for i, d in enumerate(detections)]

    def _peaks(
        self, output: np.ndarray, view: GraspView, T_track_view: np.ndarray, T_base_camera: np.ndarray | None
    ) -> tuple[Maps, Iterable[_Found]]:
        """Returns the smoothed maps and their peaks, with a network of lifts the grasps that it chooses."""
        s = self._settings
        if self._lifts is None:
            return self._maxima(output, view)
        of = ImageMaps.of_output(view.image, view.camera, output)
        before, widest = inverse(T_track_view) @ self._chosen[0], np.inf if s.tool is None else s.tool.max_opening
        how = (before, self._chosen[1]), LOOKED_AT * s.count, s.distance, s.threshold, widest, s.max_tilt
        if self._taste is not None or self._lifts.trusts == 1.0:
            return of.maps, lift_grasps(self._lifts, of, *how, self._taste)
        return of.maps, lift_grasps(self._lifts, of, *how, own=self._from_above(output, view, of, T_base_camera))

    def _from_above(
        self, output: np.ndarray, view: GraspView, of: ImageMaps, T_base_camera: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Returns GG-CNN's own grasps that are within the limits, best first, each from straight above: poses, shape
        (k, 4, 4) [m], and openings, shape (k,) [m]."""
        found = []
        for peak in self._maxima(output, view)[1]:
            at = projection.project_grasp(peak, view.image.crop, len(view.image.input), view.depth, view.camera)
            grasp = None if at is None else projection.along(at, of.frame.R[:, 2], view.camera)
            if grasp is not None and not self._rejection(grasp, view, T_base_camera, waits=True):
                found.append(grasp)
            if len(found) == self._settings.count:
                break
        T = np.array([grasp.T_camera_grasp for grasp in found]).reshape(-1, 4, 4)
        return T, np.array([grasp.width for grasp in found])

    def _maxima(self, output: np.ndarray, view: GraspView) -> tuple[Maps, list[Peak]]:
        s = self._settings
        found = maps_of(output, view, s)
        if s.threshold is None:
            return found, [highest(found)]
        return found, peaks(found, LOOKED_AT * s.count, s.distance, s.threshold)

    def _until_enough(self, candidates: Iterator[GraspCandidate]) -> Iterator[GraspCandidate]:
        """Yields the candidates until as many as are wanted passed all limits."""
        missing = self._settings.count
        for one in candidates:
            yield one
            missing -= not one.rejection
            if not missing:
                return

    def _candidates(
        self, found: Iterable[_Found], view: GraspView, T_base_camera: np.ndarray | None
    ) -> Iterator[GraspCandidate]:
        side = len(view.image.input)
        for one in found:
            if isinstance(one, LiftGrasp):
                why = self._rejection(one.grasp, view, T_base_camera, waits=True)
                yield GraspCandidate(one.peak, one.grasp, False, why, one)
                continue
            peak = one._replace(width=max(0.0, one.width))
            on_surface = projection.project_grasp(peak, view.image.crop, side, view.depth, view.camera)
            if on_surface is None:
                yield GraspCandidate(peak, None, False, "there is no reading near it")
                continue
            grasp, normal_missing, why = self._approached(on_surface, view, T_base_camera)
            if grasp is None:
                yield GraspCandidate(peak, None, normal_missing, why)
                continue
            yield GraspCandidate(peak, grasp, normal_missing, self._rejection(grasp, view, T_base_camera))

    def _rejection(
        self, grasp: projection.CameraGrasp, view: GraspView, T_base_camera: np.ndarray | None, waits: bool = False
    ) -> str:
        """Returns why a grasp is outside the limits, or the place where the hand `waits` before it; empty if not."""
        s = self._settings
        if s.limits is None:
            return ""
        T = view.T_camera_view @ grasp.T_camera_grasp
        T_base = None if T_base_camera is None else T_base_camera @ T
        opening = np.inf if s.tool is None else s.tool.max_opening
        why = rejection_reason(T, T_base, grasp.width, opening, s.limits)
        if why or not waits or T_base is None or s.tool is None:
            return why
        return wait_rejection_reason(T_base, s.tool.clearance, s.up, s.limits)

    def _approached(
        self, grasp: projection.CameraGrasp, view: GraspView, T_base_camera: np.ndarray | None
    ) -> tuple[projection.CameraGrasp | None, bool, str]:
        """Returns the grasp with its approach, whether the normal is missing, and why there is no grasp."""
        config = self._settings.approach
        if config is not None and config.kind == projection.NORMAL:
            z = grasp.T_camera_grasp[2, 3]
            normal = projection.surface_normal(view.depth, view.rays, grasp.pixel, z, view.camera.K[0, 0], config)
            turned = None if normal is None else projection.along(grasp, normal, view.camera)
            return (grasp, True, "") if turned is None else (turned, False, "")
        if config is not None and config.kind == projection.VERTICAL:
            if T_base_camera is None:
                return None, False, "the vertical is unknown: tf has no transform from the camera to kuka/base_frame"
            down = inverse(T_base_camera @ view.T_camera_view)[:3, :3] @ -self._settings.up
            return (
                projection.along(grasp, down, view.camera),
                False,
                "the line of sight is too flat for a vertical approach",
            )
        return grasp, False, ""

    def _reason(self, candidates: tuple[GraspCandidate, ...], grasps: tuple[GraspProposal, ...]) -> str:
        if grasps:
            return ""
        if not candidates and self._lifts is not None:
            return f"no grasp lifts with a probability above {self._settings.threshold:.2f}"
        if not candidates:
            return f"no peak of the quality is above {self._settings.threshold:.2f}"
        if all(c.rejection for c in candidates):
            return f"the best grasp is not published: {candidates[0].rejection}"
        return OUT_OF_SIGHT


def maps_of(output: np.ndarray, view: GraspView, settings: PipelineSettings) -> Maps:
    """Returns the maps for peaks: the output, shape (4, h, w), smoothed and with the hand's preference."""
    maps = smoothed(output, view.graspable, settings.smoothing)
    if settings.tool is None or settings.threshold is None:
        return maps
    return preferred(maps, projection.pixel_size(view.image, view.camera), settings.tool, settings.threshold)


def _proposal(
    tracked: TrackedGrasp, candidate: GraspCandidate, camera: CameraModel, T_base_camera: np.ndarray | None
) -> GraspProposal:
    T_base = None if T_base_camera is None else tracked.T
    T_camera = tracked.T if T_base_camera is None else read_only(inverse(T_base_camera) @ tracked.T)
    angle, pixel, width_px = projection.seen_by(camera, T_camera, tracked.width)
    peak, seen = candidate.peak, (angle, pixel, width_px)
    chosen = candidate.chosen
    of = None if chosen is None else chosen.uncertainty, chosen is not None
    return GraspProposal(tracked.id, T_camera, T_base, tracked.width, peak.quality, *seen, peak, *of)


_Found = Union[Peak, LiftGrasp]


class _StageTimes:
    """The duration of each stage."""

    def __init__(self, clock: Callable[[], float]) -> None:
        self._clock, self._since = clock, clock()
        self.seconds: dict[str, float] = {}

    def end(self, stage: str) -> dict[str, float]:
        """Notes the end of a stage, which is the beginning of the next."""
        now = self._clock()
        self.seconds[stage], self._since = now - self._since, now
        return self.seconds
