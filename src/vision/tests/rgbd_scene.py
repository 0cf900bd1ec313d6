"""A camera of a few lines that sees the marker board in colour and in depth, for tests of the nodes of both."""

from functools import lru_cache

import numpy as np
from depth_scene import DEPTH, PLATE, RGB, T_RGB_DEPTH, board_pose, depth_image
from tag_renderer import render

from common import clock
from common.frames import DEPTH_OPTICAL, RGB_OPTICAL

TAGS = [(0, 0.1, 0, 0), *((i, 0.06, x, y) for i, x, y in ((1, -1, 1), (2, 1, 1), (3, -1, -1), (4, 1, -1)))]
TAGS = [(i, size, 0.105 * x, 0.105 * y) for i, size, x, y in TAGS]
TRUTH = board_pose(0.9, 20.0, x=0.03, y=-0.02)
MODELS = {"rgb": (RGB, RGB_OPTICAL), "depth": (DEPTH, DEPTH_OPTICAL)}


@lru_cache(maxsize=None)
def images():
    """Returns the colour image and the depth image [mm] of the marker board at TRUTH."""
    grey = render(RGB, TRUTH, TAGS, PLATE)
    return np.stack((grey, grey, grey), axis=-1), np.rint(1000.0 * depth_image(TRUTH)).astype(np.uint16)


class Camera:
    """Publishes a pair of images again and again, with a new stamp each time."""

    def __init__(self):
        import rospy
        import tf2_ros
        from sensor_msgs.msg import CameraInfo, Image

        from common.ros.conversions import stamped_transform

        self.colour, self.depth = images()
        self.late, self.sent = 0.0, 0
        self.edit = lambda name, message: True  # of each message of rgb or depth; whether it is sent
        self.images = {name: rospy.Publisher(f"camera/{name}/image_raw", Image, queue_size=1) for name in MODELS}
        self._infos = {name: rospy.Publisher(f"camera/{name}/camera_info", CameraInfo, queue_size=1) for name in MODELS}
        self._static = tf2_ros.StaticTransformBroadcaster()
        self._static.sendTransform(stamped_transform(T_RGB_DEPTH, RGB_OPTICAL, DEPTH_OPTICAL, rospy.Time.now()))
        self._ended = clock.Event()
        self._thread = clock.Thread(target=self._loop, daemon=True)
        self._thread.start()

    def heard_everywhere(self):
        return all(p.get_num_connections() for p in (*self.images.values(), *self._infos.values()))

    def close(self):
        self._ended.set()
        self._thread.join(5.0)
        for publisher in (*self.images.values(), *self._infos.values()):
            publisher.unregister()

    def _loop(self):
        import rospy

        from common.ros.images import camera_info_message, image_message

        while not self._ended.wait(0.1):
            stamp = rospy.Time.now()
            for name, (model, frame) in MODELS.items():
                at = stamp + rospy.Duration(self.late if name == "depth" else 0.0)
                image, encoding = (self.colour, "rgb8") if name == "rgb" else (self.depth, "16UC1")
                info, image = camera_info_message(model, frame, at), image_message(image, encoding, frame, at)
                for publisher, message in ((self._infos[name], info), (self.images[name], image)):
                    if self.edit(name, message):
                        publisher.publish(message)
            self.sent += 1
