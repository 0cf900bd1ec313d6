"""What shows the simulated devices' truth and changes it, through their control ports: the node simulation, in one
process because each has little to do, and the node camera_truth.

The arm: `simulation/flange` (pose of the flange in kuka/base_frame), `simulation/status`
(stops, goals, mode, speed of the tool: now, highest since the last status, highest since the start) [m/s]. Services:
`simulation/release`, the run key after a safety stop; `simulation/back_off`, the jog keys, which move a pressing arm
back along its path; `simulation/enabling`, the enabling switch of the hand guiding. `simulation/hand_force`: a hand's
force on the tool point along the tool's axes [N], until the next one.
The world: `simulation/object_states` in kuka/base_frame; on /diagnostics the real-time factor of
the world. Services: `simulation/reset` puts the objects back to their poses of the scene, `simulation/set_scene` loads
another scene; arm and hand keep their state. In RViz: `rig_simulation.ros.world_view`.
The camera, node camera_truth: its true pose, the result of a perfect calibration.
All devices: the service `simulation/fault` switches their faults."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial

import numpy as np
import rospy
import tf2_ros
from diagnostic_msgs.msg import DiagnosticStatus, KeyValue
from geometry_msgs.msg import Point, Pose, PoseStamped, Quaternion, Vector3
from std_srvs.srv import (
    SetBool,
    SetBoolRequest,
    SetBoolResponse,
    Trigger,
    TriggerRequest,
    TriggerResponse,
)
from visualization_msgs.msg import MarkerArray

from common import clock
from common.errors import DeviceError
from common.frames import BASE, CAMERA_LINK, WORLD
from common.poses import inverse, pose
from common.ros.conversions import message_from_pose, stamped_transform
from common.ros.diagnostics import Diagnostics
from common.ros.node import run_together
from common.ros.params import arm_frames, private_config
from common.ros.publishing import DirectPublisher
from common.ros.simulated_devices import announce
from common.rotations import quaternion_from_rotation, rotation_from_quaternion, rotation_from_zyx
from rig_msgs.msg import ObjectState, ObjectStates
from rig_msgs.srv import (
    SetScene,
    SetSceneRequest,
    SetSceneResponse,
    SimulationFault,
    SimulationFaultRequest,
    SimulationFaultResponse,
)
from rig_simulation.control_port import ControlClient
from rig_simulation.node_parameters import SimulationConfig, WorldConfig
from rig_simulation.world.clock import Pace

TIMEOUT_S = 2.0


def poll(publish: Callable[[], None], period: float) -> None:
    """Calls `publish`, which asks the device and publishes its answer, until ROS shuts down: every `period` [s], or
    0.5 s while it raises DeviceError because the device does not answer."""
    retry_period_s = 0.5
    remind_s = 10.0
    start_s = 5.0  # time in which a device may start or restart without a warning
    due = answered = clock.monotonic()
    while not rospy.is_shutdown():
        try:
            publish()
        except DeviceError as error:
            if clock.monotonic() - answered > start_s:
                rospy.logwarn_throttle(remind_s, "%s", error)
            due = clock.monotonic() + retry_period_s
        else:
            answered = clock.monotonic()
            due = max(due + period, answered)
        clock.sleep(max(0.0, due - clock.monotonic()))


def trigger(client: ControlClient, request: str, done: str) -> Callable[[TriggerRequest], TriggerResponse]:
    """Returns the handler of a Trigger service that sends a request; its reply is `done`, or the refusal."""

    def handle(_: TriggerRequest) -> TriggerResponse:
        try:
            client.ask(request)
        except DeviceError as error:
            return TriggerResponse(False, str(error))
        return TriggerResponse(True, done)

    return handle


SHOWN = ("mode", "tcp_speed", "max_tcp_speed", "stops", "goals", "safety_stop", "connected")


class ArmMonitor:
    """Polls the control port of the simulated controller and publishes its state."""

    def __init__(self, config: SimulationConfig) -> None:
        self._client, self._base = ControlClient(config.host, config.arm_port, 1.0), arm_frames()(BASE)
        self._flange = DirectPublisher("simulation/flange", PoseStamped, queue_size=10)
        self._status = rospy.Publisher("simulation/status", DiagnosticStatus, queue_size=10)
        self._next_status = 0.0
        self._peak_speed = 0.0
        released = "The safety stop is released; the arm resumes."
        rospy.Service("simulation/release", Trigger, trigger(self._client, "release", released))
        rospy.Service("simulation/back_off", Trigger, trigger(self._client, "back_off", "The arm backs off."))
        rospy.Service("simulation/enabling", SetBool, self._press)
        rospy.Subscriber("simulation/hand_force", Vector3, self._push, queue_size=1)

    def _press(self, request: SetBoolRequest) -> SetBoolResponse:
        try:
            self._client.ask("set_enabling", value=request.data)
        except DeviceError as error:
            return SetBoolResponse(False, str(error))
        return SetBoolResponse(True, f"The enabling switch is {'pressed' if request.data else 'released'}.")

    def _push(self, force: Vector3) -> None:
        values = [force.x, force.y, force.z]
        if not all(map(math.isfinite, values)):
            rospy.logwarn_throttle(10.0, "The force on simulation/hand_force is %s; it is not applied.", values)
            return
        try:
            self._client.ask("set_tcp_force", value=values)
        except DeviceError as error:
            rospy.logwarn_throttle(10.0, "%s", error)

    def publish(self) -> None:
        """Publishes the present state; raises DeviceError if the controller does not answer."""
        status_period_s = 0.1
        try:
            state = self._client.ask("state")
        except DeviceError as error:
            self._publish_status(DiagnosticStatus.ERROR, str(error), {})
            raise
        flange = np.array(state["flange"])
        message = PoseStamped()
        message.header.frame_id = self._base
        message.header.stamp = rospy.Time.now() - rospy.Duration.from_sec(state["age"])
        message.pose = message_from_pose(flange)
        self._flange.publish(message)
        self._peak_speed = max(self._peak_speed, state["tcp_speed"])
        if clock.monotonic() >= self._next_status:
            self._next_status = clock.monotonic() + status_period_s
            stop = state["safety_stop"]
            values = {**{name: state[name] for name in SHOWN}, "peak_tcp_speed": self._peak_speed}
            level = DiagnosticStatus.WARN if stop else DiagnosticStatus.OK
            self._publish_status(level, stop or "The arm is ready.", values)
            self._peak_speed = 0.0

    def _publish_status(self, level: int, message: str, values: dict) -> None:
        texts = [KeyValue(name, "" if value is None else str(value)) for name, value in values.items()]
        self._status.publish(DiagnosticStatus(level=level, name="simulation", message=message, values=texts))


SLOW = 0.95  # fraction of the desired speed below which the world counts as slow


class WorldMonitor:
    """Polls the control port of the simulated world and publishes its state."""

    def __init__(self, config: SimulationConfig) -> None:
        self._client = ControlClient(config.host, config.world_port, TIMEOUT_S)
        self._pace, self._next_state = Pace(), 0.0
        self._state: dict | None = None
        self._trouble = f"The simulated world at {config.host}:{config.world_port} has not answered yet."
        self._objects = rospy.Publisher("simulation/object_states", ObjectStates, queue_size=10)
        reset = trigger(self._client, "reset", "The objects are back in their poses of the scene.")
        rospy.Service("simulation/reset", Trigger, reset)
        rospy.Service("simulation/set_scene", SetScene, self._set_scene)
        Diagnostics("simulated_world", self._diagnose)

    def publish(self) -> None:
        """Publishes the present state; raises DeviceError if the world does not answer."""
        try:
            answer = self._client.ask("objects")
            self._take_state()
        except DeviceError as error:
            self._trouble = str(error)
            raise
        self._trouble = ""
        roll, pitch, yaw = np.radians(answer["mounting"])
        R_base_world = rotation_from_zyx(yaw, pitch, roll).T
        message = ObjectStates()
        message.header.frame_id = answer["frame"]
        message.header.stamp = rospy.Time.now()
        for name, state in answer["objects"].items():
            R = R_base_world @ rotation_from_quaternion(state["quaternion"])
            place = Pose(Point(*(R_base_world @ state["position"])), Quaternion(*quaternion_from_rotation(R)))
            message.objects.append(ObjectState(name, place, state["clearance"], state["speed"], state["touches"]))
        self._objects.publish(message)

    def _take_state(self) -> None:
        state_period_s = 0.5
        now = clock.monotonic()
        if now < self._next_state:
            return
        self._next_state = now + state_period_s
        state = self._client.ask("state")
        now = clock.monotonic()
        self._pace.add(state["time"], now)
        self._state = {"world_s": state["time"], "wall_s": now, "speed": state["speed"], "contacts": state["contacts"]}

    def _diagnose(self) -> tuple[int, str, dict[str, object]]:
        state, factor = self._state, self._pace.factor
        if self._trouble or state is None:
            return DiagnosticStatus.ERROR, self._trouble, {}
        values = {name: "" if value is None else value for name, value in state.items()}
        values["real_time_factor"] = "" if factor is None else f"{factor:.3f}"
        if factor is not None and state["speed"] is not None and factor < SLOW * state["speed"]:
            slow = f"Too slow: {factor:.2f} s of the world in a second; close other programs."
            return DiagnosticStatus.WARN, slow, values
        return DiagnosticStatus.OK, "The world runs in real time.", values

    def _set_scene(self, request: SetSceneRequest) -> SetSceneResponse:
        try:
            self._client.ask("set_scene", scene=request.scene)
        except DeviceError as error:
            return SetSceneResponse(False, str(error))
        return SetSceneResponse(True, f"The scene is {request.scene}.")


def camera_in_base(fields: dict) -> np.ndarray:
    """Returns the pose of camera_link in the arm's base, with several arms in world, shape (4, 4), from the world's
    answer to `scene`."""
    from rig_simulation.world.model import camera_link_pose  # MuJoCo, which the other monitors do without
    from rig_simulation.world.scene import scene_from

    roll, pitch, yaw = np.radians(fields["mounting"])
    return inverse(pose(rotation_from_zyx(yaw, pitch, roll))) @ camera_link_pose(scene_from(fields["scene"]).camera)


def camera_truth() -> None:
    """Runs the node camera_truth with its private parameters: publishes the true pose of the camera, static, at the
    start and after each change of the scene. The node replaces camera_place, which publishes the same transform
    kuka/base_frame -> camera_link from a calibration; start only one of the two. With several arms its parent is world.
    """
    config = private_config(WorldConfig)
    client = ControlClient(config.host, config.port, TIMEOUT_S)
    broadcaster = tf2_ros.StaticTransformBroadcaster()
    published: np.ndarray | None = None

    def publish() -> None:
        nonlocal published
        fields = client.ask("scene")
        T_base_camera = camera_in_base(fields)
        frame = BASE if fields["arms"] is None else WORLD
        if published is None or not np.array_equal(published, T_base_camera):
            published = T_base_camera
            broadcaster.sendTransform(stamped_transform(T_base_camera, frame, CAMERA_LINK, rospy.Time.now()))

    poll(publish, 1.0)


class FaultService:
    """Offers the service, which passes a request to the control port of the device: it knows its own faults."""

    def __init__(self, config: SimulationConfig) -> None:
        ports = {name: getattr(config, f"{name}_port") for name in ("arm", "leap", "hand", "camera")}
        self._devices = {name: ControlClient(config.host, port, TIMEOUT_S) for name, port in ports.items() if port}
        rospy.Service("simulation/fault", SimulationFault, self._switch)

    def _switch(self, request: SimulationFaultRequest) -> SimulationFaultResponse:
        if request.device not in self._devices:
            known = ", ".join(self._devices)
            return SimulationFaultResponse(False, f"Unknown device {request.device!r}; the devices are {known}.")
        for name in ("value", "duration"):
            if not math.isfinite(getattr(request, name)):
                return SimulationFaultResponse(False, f"The {name} {getattr(request, name)} is not a finite number.")
        try:
            message = self._ask(self._devices[request.device], request)
        except DeviceError as error:
            return SimulationFaultResponse(False, str(error))
        rospy.loginfo("Faults of the simulated %s: %s", request.device, message)
        return SimulationFaultResponse(True, message)

    @staticmethod
    def _ask(device: ControlClient, request: SimulationFaultRequest) -> str:
        if not request.fault:
            listed = device.ask("faults")["faults"]
            return " ".join(f"{fault['name']}: {fault['doc']}{' (on)' if fault['on'] else ''}." for fault in listed)
        numbers = {"value": request.value or None, "duration": request.duration or None}
        active = device.ask("fault", name=request.fault, on=request.on, **numbers)["active"]
        return f"on: {', '.join(active)}." if active else "no fault is on."


def show_world(config: SimulationConfig) -> None:
    """Publishes the world's markers while somebody shows them. MuJoCo, which costs the node half of its start, is
    imported for the first one."""
    listener_s = 0.5
    topics = [rospy.Publisher(f"simulation/{name}", MarkerArray, queue_size=1) for name in ("objects", "contacts")]
    while not any(topic.get_num_connections() for topic in topics):
        if rospy.is_shutdown():
            return
        clock.sleep(listener_s)
    from rig_simulation.ros.world_view import WorldView

    poll(WorldView(ControlClient(config.host, config.world_port, TIMEOUT_S), *topics).publish, 1.0 / config.view_rate)


def simulation() -> None:
    config = private_config(SimulationConfig)
    announce()
    FaultService(config)
    jobs: list[Callable[[], None]] = [rospy.spin]
    if config.arm_port:
        jobs.append(partial(poll, ArmMonitor(config).publish, 1.0 / config.flange_rate))
    if config.world_port:
        jobs.append(partial(poll, WorldMonitor(config).publish, 1.0 / config.world_rate))
        jobs.append(partial(show_world, config))
    run_together(*jobs)
