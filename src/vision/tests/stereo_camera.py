"""A camera for tests of the nodes that show its images: red on the left, blue on the right."""

import numpy as np
from depth_scene import RGB

from common.frames import RGB_OPTICAL

DEPTH_MM = 800
REMAPS = [f"{name}:=camera/{name}" for name in ("rgb/image_raw", "rgb/camera_info", "depth/image_raw")]


class Camera:
    """Publishes images whose left half is red and whose right half is blue."""

    def __init__(self):
        import rospy
        from sensor_msgs.msg import CameraInfo, Image

        self.edit = {}  # by topic: other values of its messages
        self._colour = np.zeros((RGB.height, RGB.width, 3), np.uint8)
        self._colour[:, : RGB.width // 2, 0] = 200
        self._colour[:, RGB.width // 2 :, 2] = 200
        self.publishers = {
            name: rospy.Publisher(f"camera/{name}", kind, queue_size=1)
            for name, kind in (("rgb/image_raw", Image), ("rgb/camera_info", CameraInfo), ("depth/image_raw", Image))
        }

    def publish(self, depth=True, gap=0.0):
        """Publishes one image, and the depth of `gap` [s] later, with its stamp."""
        import rospy

        from common.ros.images import camera_info_message, image_message

        stamp = rospy.Time.now()
        if depth:
            image = np.full((RGB.height, RGB.width), DEPTH_MM, np.uint16)
            later = stamp + rospy.Duration(gap)
            self._publish("depth/image_raw", image_message(image, "16UC1", RGB_OPTICAL, later))
        self._publish("rgb/camera_info", camera_info_message(RGB, RGB_OPTICAL, stamp))
        self._publish("rgb/image_raw", image_message(self._colour, "rgb8", RGB_OPTICAL, stamp))

    def _publish(self, topic, message):
        for key, value in self.edit.get(topic, {}).items():
            owner, key = (message.header.stamp, "secs") if key == "stamp" else (message, key)
            setattr(owner, key, value)
            message.header.stamp.nsecs *= owner is message
        self.publishers[topic].publish(message)

    def publish_torn(self):
        """Publishes an image without its pixels."""
        import rospy
        from sensor_msgs.msg import Image

        torn = Image(width=640, height=480, encoding="rgb8", step=1920, data=b"short")
        torn.header.stamp = rospy.Time.now()
        self.publishers["rgb/image_raw"].publish(torn)

    def watched(self):
        """Whether somebody takes the images."""
        return self.publishers["rgb/image_raw"].get_num_connections() > 0

    def close(self):
        """Takes its topics back."""
        for publisher in self.publishers.values():
            publisher.unregister()


def middle(message):
    """The colour above the middle of each eye's image, left and right of its middle column."""
    from common.ros.images import array_from_image

    image = array_from_image(message)
    return [image[420, c] for c in (350, 600, 960 + 350, 960 + 600)]


def status(ros, name):
    """Returns a function that gives the sentence of a node's last status."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)
    return lambda: ([s.message for array in arrays for s in array.status if s.name == name] or [""])[-1]
