"""The node apriltag_ros_single_image_server: detects the tags in an image file on demand."""

from __future__ import annotations

from functools import partial

import cv2
import rospy
from std_msgs.msg import Header

from apriltag_ros.detector import TagDetector, draw_tags
from apriltag_ros.ros.messages import detection_array, read_parameters
from apriltag_ros.srv import AnalyzeSingleImage, AnalyzeSingleImageResponse
from common.camera_model import camera_model_from_info
from common.frames import frame_name


def _answer(detector: TagDetector, rectified: bool, request) -> AnalyzeSingleImageResponse:
    """Returns the detections; raises rospy.ServiceException if the image cannot be read, analysed or saved."""
    source, goal = request.full_path_where_to_get_image, request.full_path_where_to_save_image
    grey = cv2.imread(source, cv2.IMREAD_GRAYSCALE)
    if grey is None:
        raise rospy.ServiceException(f"Cannot read an image from {source!r}: check the path on the node's computer.")
    detector.reset()
    try:
        camera = camera_model_from_info(request.camera_info, grey.shape[::-1], rectified)
        result = detector.detect(grey, camera, 0.0)
        saved = not goal or cv2.imwrite(goal, draw_tags(grey, result.tags))
    except (ValueError, cv2.error) as error:
        raise rospy.ServiceException(f"The image {source!r} was not analysed: {error}.") from error
    if not saved:
        raise rospy.ServiceException(f"Cannot save the image as {goal!r}: check that the folder exists.")
    header = Header(frame_id=frame_name(request.camera_info.header.frame_id), stamp=rospy.Time.now())
    return AnalyzeSingleImageResponse(detection_array(result.targets, header))


def main() -> None:
    settings, targets = read_parameters()
    answer = partial(_answer, TagDetector(settings, targets), settings.rectified)
    rospy.Service("single_image_tag_detection", AnalyzeSingleImage, answer)
    rospy.loginfo("Ready: %s.", rospy.resolve_name("single_image_tag_detection"))
    rospy.spin()
