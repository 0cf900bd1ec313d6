"""The node stereo_view: draws the view for the headset in a window and on the topic stereo_view/image."""

from __future__ import annotations

import os
import sys
import threading
from concurrent.futures import ThreadPoolExecutor

import rospy
from python_qt_binding.QtCore import QTimer
from python_qt_binding.QtWidgets import QApplication
from sensor_msgs.msg import Image

from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.images import image_message
from common.ros.node import run, while_running
from common.ros.params import private_config
from vision.node_parameters import WindowConfig
from vision.ros.stereo.eye_images import StereoPictures
from vision.ros.stereo.screen import StereoScreen, find_screen
from vision.stereo.config import StereoViewConfig

REFRESH_S = 0.2
"""An old picture is drawn again after so long, with its new age."""
POLL_MS = 100
FRAME = "headset"


def _run() -> None:
    output = private_config(WindowConfig, others=("view",)).output
    config = private_config(StereoViewConfig, "view")
    if not any(name in os.environ for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM")):
        raise DeviceError("The headset's view needs a screen: neither DISPLAY nor WAYLAND_DISPLAY is set.")
    application = QApplication(sys.argv[:1])
    screen = find_screen(application, output)
    rospy.loginfo("Shows the view %s.", f"on {screen.name()}" if screen else "in a window: no display is a Rift")
    window = StereoScreen()
    window.show_on(application, screen)
    pictures = StereoPictures(config)
    pictures.listen_if(True)
    ended = threading.Event()
    pool = ThreadPoolExecutor(1, "draw")
    drawn = pool.submit(_draw, pictures, window, ended)
    Diagnostics("stereo_view", pictures.diagnose)
    end = QTimer()
    # Its time-outs also give Python the chance to see signals.
    end.timeout.connect(lambda: application.quit() if rospy.is_shutdown() or drawn.done() else None)
    end.start(POLL_MS)
    application.exec_()
    end.stop()
    ended.set()
    drawn.result()
    pool.shutdown()


def _draw(pictures: StereoPictures, window: StereoScreen, ended: threading.Event) -> None:
    publisher = rospy.Publisher("stereo_view/image", Image, queue_size=1)
    while not ended.is_set():
        seen = pictures.wait(REFRESH_S)
        if seen is None:
            continue
        picture = seen.view.screen.draw(seen.eyes.left, seen.eyes.right)
        window.show_picture(picture)
        if publisher.get_num_connections():
            with while_running():
                publisher.publish(image_message(picture, "rgb8", FRAME, seen.stamp))


def main() -> None:
    """Runs the node until its window is closed or ROS shuts down."""
    run("stereo_view", _run)
