"""The node ggcnn: depth images in, grasps out.

Topics, below ggcnn/: img/grasp, img/grasp_plain, img/depth, img/ang, out/command and out/target_pose as the original
has them; out/grasps with all grasps or the reason why there is none; img/heat_map and markers for people. In tf
camera_target_frame below camera_depth_frame, and, with a view of the table, ggcnn/view below the camera.
"""

from __future__ import annotations

import ctypes
from collections.abc import Mapping
from time import perf_counter

import cv2
import numpy as np
import rospy
import torch
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import PoseStamped
from sensor_msgs.msg import Image
from std_msgs.msg import Float32MultiArray, Header
from visualization_msgs.msg import MarkerArray

from common import clock
from common.errors import RigError
from common.frames import BASE, DEPTH, GRASP_TARGET, GRASP_VIEW
from common.mounting import rotation_of_mounting
from common.ros.broadcaster import FreshBroadcaster
from common.ros.conversions import stamped_pose, stamped_transform
from common.ros.diagnostics import Diagnostics, StageTimes
from common.ros.images import image_message
from common.ros.node import run
from common.ros.params import private_values
from common.ros.service_calls import MasterLost, ask_master
from common.sentences import without_numbers
from grasp_msgs.msg import GraspList
from grasping.network.depth_image import NETWORK_SIDE, TABLE, Crop, centre_crop, prepare
from grasping.network.networks import infer
from grasping.pipeline import drawing
from grasping.pipeline.pipeline import OUT_OF_SIGHT, GraspPipeline, GraspProposal, PipelineResult
from grasping.pipeline.projection import depth_between_fingers
from grasping.pipeline.settings import NEVER, GgcnnSettings, live_origin, overlaid, sentences, settings_from
from grasping.pipeline.tool_pose import ASKED, Reachability
from grasping.poses.taste import PoseTaste
from grasping.poses.taste_file import of_kind
from grasping.ros import ggcnn_messages as messages
from grasping.ros.camera_input import DepthImage, DepthStream
from grasping.ros.pose_lookup import PoseLookup
from grasping.ros.reach_client import ReachClient
from grasping.ros.weight_files import load_lifts, load_network, load_refinement, own_yaml

M_TRIM_THRESHOLD = -1  # mallopt(3)
M_MMAP_THRESHOLD = -3


class ReasonLog:
    """Logs a reason when more than its numbers change; `present` is the newest, a clause, empty with a grasp."""

    def __init__(self) -> None:
        self.present = "no depth image has been looked at"
        self._kind = self.present

    def update(self, reason: str) -> None:
        """Takes the newest reason."""
        self.present = reason
        kind = without_numbers(reason)
        if kind == self._kind:
            return
        self._kind = kind
        if reason:
            rospy.logwarn("No grasp, or none that is known to be reachable: %s.", reason)
        else:
            rospy.loginfo("There are grasps, and the best is reachable.")


class RefinementKind:
    """The parameter refinement_kind, which may be changed while the node runs."""

    def __init__(self, kinds: Mapping[str, PoseTaste], kind: str) -> None:
        self._kinds = kinds
        self._kind = kind
        self._looked = clock.monotonic()

    def changed(self) -> PoseTaste | None:
        """Returns the taste of another kind than before, None otherwise; one that is not known is logged."""
        kind_period_s = 1.0
        if not self._kinds or clock.monotonic() - self._looked < kind_period_s:
            return None
        self._looked = clock.monotonic()
        try:
            kind = ask_master("getParam", rospy.resolve_name("~refinement_kind"))
        except MasterLost:
            return None
        if kind is None or str(kind) == self._kind:
            return None
        self._kind = str(kind)
        try:
            found = of_kind(self._kinds, self._kind)
        except RigError as error:
            rospy.logwarn("%s The grasps remain those of the kind before.", error)
            return None
        rospy.loginfo("The grasps are refined for the kind %r.", self._kind)
        return found


class GgcnnNode:
    """Looks for grasps in the newest depth image, again and again."""

    def __init__(
        self, settings: GgcnnSettings, pipeline: GraspPipeline, kind: RefinementKind, about: dict[str, str]
    ) -> None:
        self._settings = settings
        self._pipeline = pipeline
        self._kind = kind
        self._about = about
        self._milliseconds: dict[str, float] = {}
        self._grasps = self._image_count = self._normals_missing = 0
        self._reasons = ReasonLog()
        self._images = {
            name: rospy.Publisher(f"ggcnn/img/{name}", Image, queue_size=1)
            for name in ("grasp", "grasp_plain", "depth", "ang", "heat_map")
        }
        self._command = rospy.Publisher("ggcnn/out/command", Float32MultiArray, queue_size=1, tcp_nodelay=True)
        self._target = rospy.Publisher("ggcnn/out/target_pose", PoseStamped, queue_size=1, tcp_nodelay=True)
        self._list = rospy.Publisher("ggcnn/out/grasps", GraspList, queue_size=1, tcp_nodelay=True)
        self._markers = rospy.Publisher("ggcnn/markers", MarkerArray, queue_size=1)
        self._broadcaster = FreshBroadcaster()
        self._times = StageTimes("ggcnn")
        self._camera_pose = PoseLookup()
        self._reach = ReachClient(settings.reach, settings.tool)
        self._stream = DepthStream(settings.input)
        Diagnostics("ggcnn", self._diagnose)

    def run(self) -> None:
        wait_s = 0.2
        silent_period_s = 0.5
        reported_silence = 0.0
        while not rospy.is_shutdown():
            image = self._stream.newest(wait_s)
            if image is not None:
                self._take(image)
                continue
            silence = self._stream.silence()
            if silence and clock.monotonic() - reported_silence >= silent_period_s:
                reported_silence = clock.monotonic()
                self._pipeline.reset()
                self._publish(Header(stamp=rospy.Time.now()), [], silence)

    def _take(self, image: DepthImage) -> None:
        if image.reason:
            self._publish(image.header, [], image.reason)
            return
        taste = self._kind.changed()
        if taste is not None:
            self._pipeline.prefer(taste)
        started, header = perf_counter(), image.header
        T_base_camera, unknown = self._camera_pose.in_base(header.frame_id, header.stamp)
        found = self._pipeline.step(image.depth, image.camera, T_base_camera, header.stamp.to_sec())
        proposals = self._reach.look_up(found.grasps)
        if unknown:
            proposals = [(p, Reachability(False, unknown)) for p, _ in proposals]
        self._publish(header, proposals, found.reason)
        best = proposals[0][0] if proposals and not proposals[0][1].refused else None
        if best is not None:
            self._publish_best(image, best)
        self._times.done(header.stamp)
        published = perf_counter()
        self._draw(header, found, proposals, best)
        self._image_count += 1
        self._normals_missing += found.normals_missing
        latency = (rospy.Time.now() - header.stamp).to_sec()
        stages = {**found.seconds, "draw": perf_counter() - published, "all": published - started}
        self._time({**stages, "latency": latency})

    def _publish(self, header: Header, proposals: list[tuple[GraspProposal, Reachability]], reason: str) -> None:
        self._grasps = len(proposals)
        self._list.publish(messages.grasp_list(header, proposals, reason))
        self._markers.publish(messages.markers(header, proposals))
        self._stream.inputs.done()
        why = reason or proposals[0][1].reason
        if why not in (ASKED, OUT_OF_SIGHT):  # they last for an image or two only
            self._reasons.update(why)

    def _publish_best(self, image: DepthImage, best: GraspProposal) -> None:
        header, crop = image.header, self._settings.crop
        window = centre_crop(image.depth.shape, crop.side, crop.rows_up)
        self._command.publish(messages.command(best, depth_between_fingers(image.depth, window)))
        known = best.T_base_grasp is not None
        T, frame = (best.T_base_grasp, BASE) if known else (best.T_camera_grasp, header.frame_id)
        self._target.publish(stamped_pose(T, frame, header.stamp))
        T_depth_optical = self._camera_pose.fixed(DEPTH, header.frame_id)
        if T_depth_optical is not None:
            T = T_depth_optical @ best.T_camera_grasp
            self._broadcaster.sendTransform(stamped_transform(T, DEPTH, GRASP_TARGET, header.stamp))

    def _draw(self, header: Header, found: PipelineResult, proposals: list, best: GraspProposal | None) -> None:
        if found.view is None or found.maps is None:
            return
        frame = header.frame_id
        if self._settings.main.view == TABLE:
            T = found.view.T_camera_view
            self._broadcaster.sendTransform(stamped_transform(T, header.frame_id, GRASP_VIEW, header.stamp))
            frame = GRASP_VIEW
        plain = drawing.plain(found.maps) if self._wanted("grasp") or self._wanted("grasp_plain") else None
        refused = {p.id for p, reach in proposals if reach.refused}
        reason = found.reason or proposals[0][1].reason
        images = {
            "grasp": ("bgr8", lambda: drawing.with_disc(plain, best)),
            "grasp_plain": ("bgr8", lambda: plain),
            "depth": ("32FC1", lambda: np.asarray(found.view.image.input, np.float32)),
            "ang": ("32FC1", lambda: np.asarray(found.maps.angle, np.float32)),
            "heat_map": ("bgr8", lambda: drawing.heat_map(found, refused, reason)),
        }
        for name, (encoding, draw) in images.items():
            if self._wanted(name):
                self._images[name].publish(image_message(draw(), encoding, frame, header.stamp))

    def _wanted(self, name: str) -> bool:
        return self._images[name].get_num_connections() > 0

    def _time(self, seconds: dict[str, float]) -> None:
        rate_weight = 0.1  # weight of the newest value in the times that diagnostics show
        for name, value in seconds.items():
            before = self._milliseconds.get(name, 1e3 * value)
            self._milliseconds[name] = before + rate_weight * (1e3 * value - before)

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        values = {
            "pictures": self._image_count,
            "received": self._stream.received,
            "skipped": self._stream.skipped,
            "grasps": self._grasps,
            "normals_missing": self._normals_missing,
            "reach_answers": self._reach.answers,
            **{f"ms_{name}": f"{value:.1f}" for name, value in self._milliseconds.copy().items()},
            **self._about,
        }
        reason = self._reasons.present or self._stream.inputs.fault(logged=False)
        return (DiagnosticStatus.WARN if reason else DiagnosticStatus.OK), reason or "There are grasps.", values


def _measured(pipeline: GraspPipeline) -> float:
    """Returns how long the network takes for one image [s], after the first ones, which take longer."""
    warm_up = 5
    image = prepare(np.ones((NETWORK_SIDE, NETWORK_SIDE), np.float32), Crop(0, 0, NETWORK_SIDE))
    seconds = []
    for _ in range(warm_up):
        begin = perf_counter()
        infer(pipeline.network, image.input)
        seconds.append(perf_counter() - begin)
    return min(seconds)


def _keep_memory() -> None:
    """Keeps freed memory: else it goes back to the system after each layer of a network, and each page that comes anew
    is a fault.
    """
    kept_bytes = 2**26  # that stay with the process when they are free
    largest_bytes = 2**25  # of an array among them
    libc = ctypes.CDLL(None)
    libc.mallopt(M_TRIM_THRESHOLD, kept_bytes)
    libc.mallopt(M_MMAP_THRESHOLD, largest_bytes)


def _run() -> None:
    _keep_memory()
    values = overlaid({**own_yaml("ggcnn.yaml"), "tool": own_yaml("tool_pose.yaml")}, private_values())
    settings = settings_from(values, prefix="~")
    for sentence in sentences(settings):
        rospy.loginfo("%s", sentence)
    loaded = load_network(settings.network)
    mismatch = loaded.mismatch(settings.tool.hand)
    if mismatch:
        rospy.logwarn("%s: %s", settings.network.weights, mismatch)
    torch.set_num_threads(settings.network.threads)
    cv2.setNumThreads(settings.network.threads)
    main = settings.main
    lifts, lifts_sha256, why = None, "", "lifts is never."
    if main.lifts != NEVER:
        lifts, lifts_sha256, why = load_lifts(main.lift_weights, main.lifts, settings.tool.hand, loaded.sha256)
    kinds: Mapping[str, PoseTaste] = {}
    if main.refine:
        if lifts is None:
            raise RigError(f"refine: true needs a network of lifts. {why}")
        rig = live_origin(settings, loaded.sha256, rospy.get_param("kuka/robot", None), lifts_sha256)
        kinds = load_refinement(main.refinement_weights, rig)
    taste = of_kind(kinds, main.refinement_kind) if main.refine else None
    if lifts is None:
        rospy.loginfo("GG-CNN alone proposes grasps. %s", why)
    else:
        rospy.loginfo("A network of lifts chooses the grasps, each with an approach of its own.")
        if taste is None and lifts.trusts < 1.0:
            rospy.loginfo("It takes GG-CNN's where these lift with more than %.0f %%.", 100.0 * lifts.trusts)
    try:
        up = rotation_of_mounting(rospy.get_param("kuka/mounting", (0.0, 0.0, 0.0)))[2]
    except (TypeError, ValueError) as error:
        raise RigError(f"The parameter kuka/mounting is not roll, pitch and yaw: {error}.") from None
    pipeline = GraspPipeline(settings.views(), loaded.network, settings.steps(up), perf_counter, lifts, taste)
    file, name, sha256, milliseconds = (
        settings.network.weights,
        loaded.name,
        loaded.sha256[:12],
        1e3 * _measured(pipeline),
    )
    threads = settings.network.threads
    rospy.loginfo(f"{file} ({name}, SHA-256 {sha256}...) takes {milliseconds:.0f} ms an image on {threads} threads.")
    about = {"network": name, "weights": sha256, "weights_hand": loaded.hand, "lifts": str(lifts is not None).lower()}
    GgcnnNode(settings, pipeline, RefinementKind(kinds, main.refinement_kind), about).run()


def main() -> None:
    run("ggcnn", _run, disposable=True)
