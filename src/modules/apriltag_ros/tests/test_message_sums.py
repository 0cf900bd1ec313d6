"""The messages are those of the published package: their MD5 sums are what decides whether two ROS nodes can talk."""

import pytest

pytestmark = pytest.mark.ros


@pytest.mark.parametrize(
    ("kind", "name", "md5"),
    [
        ("msg", "AprilTagDetection", "090173a6e2b6c8fd96ce000fe9378b4e"),
        ("msg", "AprilTagDetectionArray", "2b6c03434883a5c9897c13b5594dbd91"),
        ("srv", "AnalyzeSingleImage", "d60d994450f73cbdba772751d78c9952"),
    ],
)
def test_sum(kind, name, md5):
    message = getattr(pytest.importorskip(f"apriltag_ros.{kind}"), name)
    assert (message._type, message._md5sum) == (f"apriltag_ros/{name}", md5)
