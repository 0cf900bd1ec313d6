"""Shows the simulated world in RViz: table, objects and contact forces. Topics, both visualization_msgs/MarkerArray in
kuka/base_frame, with several arms in world: `simulation/objects`, and `simulation/contacts` with an arrow for each pair
of touching bodies, 6 cm a newton, and beside each body the forces on it, in N."""

from __future__ import annotations

import numpy as np
import rospy
from geometry_msgs.msg import Point, Pose, Quaternion
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common.numbers import LABEL_M
from common.poses import inverse
from common.rotations import quaternion_from_rotation
from rig_simulation.control_port import ControlClient
from rig_simulation.recording import display
from rig_simulation.world.model import WorldCopy

KINDS = {display.BOX: Marker.CUBE, display.BALL: Marker.SPHERE, display.CYLINDER: Marker.CYLINDER}
OF_ROBOT, OF_OTHERS = ColorRGBA(1.0, 0.45, 0.0, 1.0), ColorRGBA(0.35, 0.65, 1.0, 0.9)


class WorldView:
    """Follows the world through its control port and publishes its objects and contacts on two topics."""

    def __init__(self, world: ControlClient, objects: rospy.Publisher, contacts: rospy.Publisher) -> None:
        self._client, self._world = world, WorldCopy(world)
        self._objects, self._contacts = objects, contacts

    def publish(self) -> None:
        """Publishes the present state if somebody listens; raises DeviceError if the world does not answer."""
        if self._objects.get_num_connections() or self._contacts.get_num_connections():
            self._world.follow()
            self._publish(self._client.ask("contacts")["contacts"])

    def _publish(self, contacts: list[dict]) -> None:
        found = display.shapes(self._world.model, self._world.data)
        T_base_world = inverse(display.base_pose(self._world.data))
        bodies: dict[str, list[display.Shape]] = {}
        for shape in found:
            bodies.setdefault(shape.body, []).append(shape)
        touched: dict[str, list[display.PairForce]] = {}
        pairs = display.pair_forces(contacts)
        for pair in pairs:
            touched.setdefault(pair.bodies[0], []).append(pair)
        frame = self._world.description.frame
        self._objects.publish(_array([shape_marker(shape) for shape in found], frame))
        marks = [arrow_marker(arrow, T_base_world) for arrow in display.arrows(pairs)]
        marks += [label_marker(pairs, bodies.get(body, []), T_base_world) for body, pairs in touched.items()]
        self._contacts.publish(_array(marks, frame))


def shape_marker(shape: display.Shape) -> Marker:
    """Returns the marker of a shape."""
    marker = Marker(type=KINDS[shape.kind], ns=shape.body, color=ColorRGBA(*shape.colour))
    R, p = shape.T_base_shape[:3, :3], shape.T_base_shape[:3, 3]
    marker.pose = Pose(Point(*p.tolist()), Quaternion(*quaternion_from_rotation(R)))
    marker.scale.x, marker.scale.y, marker.scale.z = shape.size.tolist()
    return marker


def arrow_marker(arrow: display.Arrow, T_base_world: np.ndarray) -> Marker:
    shaft_m = 0.012
    head_m = 0.024
    head_length_m = 0.03
    marker = Marker(type=Marker.ARROW, ns="force", color=OF_ROBOT if arrow.by_robot else OF_OTHERS)
    marker.pose.orientation.w = 1.0
    marker.scale.x, marker.scale.y, marker.scale.z = shaft_m, head_m, head_length_m
    marker.points = [_point(arrow.tail, T_base_world), _point(arrow.tip, T_base_world)]
    return marker


def label_marker(pairs: list[display.PairForce], parts: list[display.Shape], T_base_world: np.ndarray) -> Marker:
    """Returns the label of all forces on one body, beside the body if its shapes are known."""
    label_beside_m = 0.11
    by_robot = any(pair.by_robot for pair in pairs)
    marker = Marker(type=Marker.TEXT_VIEW_FACING, ns="label", color=OF_ROBOT if by_robot else OF_OTHERS)
    marker.pose.orientation.w = 1.0
    if parts:
        marker.pose.position = Point(*display.beyond(parts, T_base_world[:3, 1], label_beside_m).tolist())
    else:
        marker.pose.position = _point(pairs[0].position, T_base_world)
    marker.scale.z = LABEL_M
    marker.text = "\n".join(f"{display.short(pair.bodies[1])} {pair.newtons:.1f} N" for pair in pairs)
    return marker


def _point(position: np.ndarray, T_base_world: np.ndarray) -> Point:
    return Point(*(T_base_world[:3, :3] @ position + T_base_world[:3, 3]).tolist())


def _array(markers: list[Marker], frame: str) -> MarkerArray:
    """Returns the markers with the frame, ids and lifetime, after one that removes the previous markers."""
    lifetime_s = 1.0  # markers of a stopped world disappear after this time
    now = rospy.Time.now()
    for i, marker in enumerate(markers):
        marker.header.frame_id, marker.header.stamp = frame, now
        marker.id = i
        marker.lifetime = rospy.Duration.from_sec(lifetime_s)
    clear = Marker(action=Marker.DELETEALL)
    clear.header.frame_id, clear.header.stamp = frame, now
    return MarkerArray([clear, *markers])
