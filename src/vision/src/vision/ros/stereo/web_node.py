"""The node stereo_web: serves the view for headsets and phones as a page; asks the camera only while one looks."""

from __future__ import annotations

import cv2
import numpy as np
import rospy

from common.ros.diagnostics import Diagnostics
from common.ros.node import run
from common.ros.params import private_config
from vision.node_parameters import WebConfig
from vision.ros.stereo.eye_images import Seen, StereoPictures
from vision.ros.stereo.web import Frame, StereoWeb
from vision.stereo.config import StereoViewConfig

REFRESH_S = 0.2


def _run() -> None:
    config = private_config(StereoViewConfig, "view")
    web = StereoWeb(private_config(WebConfig, "web"))
    rospy.loginfo("The view is at %s", web.address)
    pictures = StereoPictures(config)
    Diagnostics("stereo_web", pictures.diagnose)
    try:
        while not rospy.is_shutdown():
            pictures.listen_if(web.watched)
            seen = pictures.wait(REFRESH_S)
            if seen is not None and seen.new and web.watched:
                web.put(_frame(seen, config.jpeg_quality))
    finally:
        web.close()


def _frame(seen: Seen, quality: int) -> Frame:
    picture = np.hstack((seen.eyes.left, seen.eyes.right))
    _, jpeg = cv2.imencode(".jpg", picture[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY, quality])
    return Frame(jpeg.tobytes(), seen.view.tangents, seen.eyes.deep)


def main() -> None:
    """Runs the node until ROS shuts down."""
    run("stereo_web", _run)
