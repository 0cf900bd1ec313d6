"""A node of ROS 2, in its environment, for test_ros2_bridge_real.py: what it does are its arguments, what happens it
prints, a line of JSON each."""

import json
import math
import sys
import time

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import TransformStamped, WrenchStamped
from rclpy.action import ActionClient
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import CameraInfo, CompressedImage, JointState
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from kuka_msgs.action import Move

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
HEARD = {
    "joint_states": (JointState, lambda m: [*m.name, *m.position]),
    "tf": (TFMessage, lambda m: [t.child_frame_id for t in m.transforms]),
    "tf_static": (TFMessage, lambda m: sorted(t.child_frame_id for t in m.transforms)),
    "robot_description": (String, lambda m: m.data),
    "diagnostics": (DiagnosticArray, lambda m: [s.name for s in m.status]),
    "kuka/flange_wrench": (WrenchStamped, lambda m: [m.wrench.force.x, m.wrench.torque.z]),
    "camera/rgb/image_raw/compressed": (CompressedImage, lambda m: [m.format, len(m.data) > 100]),
    "camera/rgb/camera_info": (CameraInfo, lambda m: [m.height, m.width, m.k[0]]),
    "leap_kuka/stream": (DiagnosticStatus, lambda m: m.message),
    "leap_kuka/state": (DiagnosticStatus, lambda m: {v.key: v.value for v in m.values}),
    "kuka/status": (DiagnosticStatus, lambda m: [m.level[0], {v.key: v.value for v in m.values}]),
}


def say(**what):
    print(json.dumps(what), flush=True)


def listen(node, arm=""):
    for topic, (kind, read) in HEARD.items():
        quality = LATCHED if topic in ("tf_static", "robot_description") else 10
        name = f"/{topic}" if topic.startswith(("tf", "diagnostics", "camera")) else f"/{arm}{topic}"
        node.create_subscription(kind, name, lambda m, t=topic, r=read: say(topic=t, value=r(m)), quality)


def mistake(node):
    """Expects another type than it is."""
    node.create_subscription(String, "/kuka/status", lambda m: say(heard=m.data), 10)


def publish(node, kind, name="kuka/tool_frame/desired"):
    publisher = node.create_publisher(TFMessage, "/tf_static" if kind == "static" else "/tf", LATCHED)
    message = TransformStamped(child_frame_id=name)
    message.header.frame_id = "kuka/tool_frame/home"
    message.transform.rotation.w = 1.0
    message.transform.translation.x = math.nan if kind == "nan" else 0.125

    def step():
        message.header.stamp = node.get_clock().now().to_msg()
        publisher.publish(TFMessage(transforms=[message]))

    node.create_timer(0.02, step)


def move(node, kind, arm=""):
    client = ActionClient(node, Move, f"/{arm}kuka/move")
    client.wait_for_server()
    goal = Move.Goal(kind=Move.Goal.NAMED, name=kind)
    sent = client.send_goal_async(goal, lambda m: say(feedback=m.feedback.fraction))
    rclpy.spin_until_future_complete(node, sent)
    handle = sent.result()
    say(accepted=handle.accepted)
    result = handle.get_result_async()
    if kind == "cancelled":
        handle.cancel_goal_async()
    rclpy.spin_until_future_complete(node, result)
    say(status=result.result().status, message=result.result().result.message)


def main():
    rclpy.init()
    action, *words = sys.argv[1:]
    node = rclpy.create_node(f"peer_{action}_{time.time_ns() % 10**6}")
    {"listen": listen, "mistake": mistake, "publish": publish, "move": move}[action](node, *words)
    if action != "move":
        rclpy.spin(node)


main()
