"""Camera messages: there and back, padding, byte order, and what is refused."""

import numpy as np
import pytest

from common.camera_model import camera_model_from_info, pinhole, same_camera

pytest.importorskip("rig_msgs.srv")
import rospy
from sensor_msgs.msg import CameraInfo, RegionOfInterest

from common.ros import images

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros


def messages():
    return images, rospy.Time(3, 4)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1", "rgb8", "bgr8", "rgba8", "bgra8", "mono16", "16UC1", "32FC1"])
def test_a_picture_comes_back_from_its_message(encoding):
    images, stamp = messages()
    kind, channels = images.TYPES[encoding]
    picture = np.random.default_rng(1).integers(0, 255, (4, 5, channels)).astype(kind)
    picture = picture if channels > 1 else picture[..., 0]
    message = images.image_message(picture, encoding, "camera_frame", stamp)
    assert (message.header.frame_id, message.header.stamp, message.encoding) == ("camera_frame", stamp, encoding)
    np.testing.assert_array_equal(images.array_from_image(message), picture)


def test_padded_rows_and_foreign_byte_order_are_understood():
    images, stamp = messages()
    message = images.image_message(np.arange(6, dtype=np.uint16).reshape(2, 3), "16UC1", "f", stamp)
    message.data = b"\0\0\0\1\0\2xx\0\3\0\4\0\5xx"
    message.step, message.is_bigendian = 8, 1
    np.testing.assert_array_equal(images.array_from_image(message), [[0, 1, 2], [3, 4, 5]])


@pytest.mark.parametrize(
    "change, complaint",
    [
        ({"encoding": "yuv422"}, "yuv422"),
        ({"data": b"abc"}, "3 bytes"),
        ({"width": 0}, "0 x"),
        ({"step": 1}, "rows of 1"),
    ],
)
def test_a_broken_picture_is_refused(change, complaint):
    images, stamp = messages()
    message = images.image_message(np.zeros((2, 3), np.uint16), "16UC1", "f", stamp)
    for key, value in change.items():
        setattr(message, key, value)
    with pytest.raises(ValueError, match=complaint):
        images.array_from_image(message)


def test_an_array_of_another_type_is_no_picture():
    images, stamp = messages()
    with pytest.raises(ValueError, match="float64"):
        images.image_message(np.zeros((2, 3)), "32FC1", "f", stamp)


def test_a_camera_comes_back_from_its_message():
    images, stamp = messages()
    model = pinhole("f", 640, 480, [[525.0, 0, 319.5], [0, 524.0, 239.5], [0, 0, 1]])
    back = camera_model_from_info(images.camera_info_message(model, "f", stamp))
    for name in ("K", "D", "R", "P"):
        np.testing.assert_array_equal(getattr(back, name), getattr(model, name))


K = [500.0, 0.0, 320.0, 0.0, 510.0, 240.0, 0.0, 0.0, 1.0]
P = [400.0, 0.0, 310.0, 0.0, 0.0, 410.0, 230.0, 0.0, 0.0, 0.0, 1.0, 0.0]
TURNED = [0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
TAKEN = [  # camera_info, size of the image, whether that is rectified; what differs from K, P, TURNED and 640 x 480
    ({}, None, False, {}),
    ({"R": [0.0] * 9}, None, False, {"R": np.eye(3).ravel()}),
    ({"P": [0.0] * 12}, None, False, {"P": np.insert(np.reshape(K, (3, 3)), 3, 0.0, axis=1).ravel()}),
    ({"width": 0, "height": 0}, (642, 478), False, {"width": 642, "height": 478}),
    ({"width": 0, "height": 0}, None, False, {"width": 0, "height": 0}),
    ({"binning_x": 2, "binning_y": 2}, (320, 240), False,
     {"width": 320, "height": 240, "K": [250.0, 0.0, 160.0, 0.0, 255.0, 120.0, 0.0, 0.0, 1.0],
      "P": [200.0, 0.0, 155.0, 0.0, 0.0, 205.0, 115.0, 0.0, 0.0, 0.0, 1.0, 0.0]}),
    ({"roi": {"x_offset": 20, "y_offset": 40, "width": 100, "height": 50}}, (100, 50), False,
     {"width": 100, "height": 50, "K": [500.0, 0.0, 300.0, 0.0, 510.0, 200.0, 0.0, 0.0, 1.0],
      "P": [400.0, 0.0, 290.0, 0.0, 0.0, 410.0, 190.0, 0.0, 0.0, 0.0, 1.0, 0.0]}),
    ({"D": [0.1, 0.2, 0.3, 0.4]}, None, False, {"D": [0.1, 0.2, 0.3, 0.4, 0.0]}),
    ({"D": [], "distortion_model": ""}, None, False, {}),
    ({"D": [*[0.1] * 12, 0.0, 0.0], "distortion_model": "rational_polynomial"}, None, False, {"D": [0.1] * 12}),
    ({"D": [0.1] * 8, "distortion_model": "rational_polynomial"}, None, False, {"D": [0.1] * 8}),
    ({"K": [0.0] * 9, "R": [0.0] * 9, "D": [0.1] * 4, "distortion_model": "equidistant"}, None, True,
     {"K": np.reshape(P, (3, 4))[:, :3].ravel(), "R": np.eye(3).ravel()}),
]  # fmt: skip
REFUSED = [
    ({"K": [0.0] * 9}, None, "focal lengths in K of its camera_info are 0 and 0"),
    ({"K": [0.0] * 9, "P": [0.0] * 12}, None, "not calibrated"),
    ({"P": [400.0, *[0.0] * 11]}, None, "focal lengths in P"),
    ({"P": [*P[:10], 0.0, 0.0]}, None, "last row of P"),
    ({"K": [float("nan")] * 9}, None, "not finite"),
    ({"R": [0.1] * 9}, None, "no rotation"),
    ({"R": [-1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0]}, None, "no rotation"),
    ({"D": [0.1] * 4, "distortion_model": "equidistant"}, None, "equidistant"),
    ({"D": [0.1] * 14, "distortion_model": "rational_polynomial"}, None, "neither plumb_bob nor rational"),
    ({}, (640, 360), "the image is 640 x 360, but its camera_info says 640 x 480"),
    ({"binning_x": 2, "binning_y": 2}, (640, 480), "says 320 x 240"),
    ({"width": 0, "height": 0}, (320, 240), "K in the camera_info: .* cannot belong to an image of 320 x 240"),
    ({"P": [K[0] / 2, 0, 160, 0, 0, 255, 120, *P[7:]]}, None, "P in the camera_info: .* 160, 120 px cannot belong to"),
    ({"K": [K[0] / 640, 0, 0.5, 0, K[4] / 480, 0.5, 0, 0, 1]}, None, "K in the camera_info: .* image of 640 x 480"),
]


def info(roi=None, **changes):
    values = dict(height=480, width=640, distortion_model="plumb_bob", D=[0.0] * 5, K=K, R=TURNED, P=P)
    message = CameraInfo(**{**values, **changes}, roi=RegionOfInterest(**(roi or {})))
    message.header.frame_id = "/camera"
    return message


@pytest.mark.parametrize(("changes", "size", "rectified", "found"), TAKEN)
def test_camera_info_is_taken_as_image_geometry_does(changes, size, rectified, found):
    images, _ = messages()
    model = camera_model_from_info(info(**changes), size, rectified)
    expected = {"width": 640, "height": 480, "K": K, "R": TURNED, "P": P, "D": [0.0] * 5, **found}
    assert (model.name, model.width, model.height) == ("camera", expected.pop("width"), expected.pop("height"))
    for name, values in expected.items():
        np.testing.assert_array_equal(getattr(model, name).ravel(), values, err_msg=name)


@pytest.mark.parametrize(("changes", "size", "reason"), REFUSED)
def test_camera_info_that_cannot_be_used_is_named(changes, size, reason):
    """Reported in https://github.com/AprilRobotics/apriltag_ros/issues/3,
    https://github.com/AprilRobotics/apriltag_ros/issues/28,
    https://github.com/AprilRobotics/apriltag_ros/issues/79: camera_info of zeros: poses at the origin. Tried: K of
    zeros.
    """
    images, _ = messages()
    with pytest.raises(ValueError, match=reason):
        camera_model_from_info(info(**changes), size)


@pytest.mark.parametrize("D", [[0.1, -0.2, 0.003, -0.004, 0.05, 0.02, 0.03, 0.04], [0.1, -0.2, *[0.01] * 10]])
def test_a_longer_distortion_is_that_of_opencv_and_comes_back_from_its_message(D):
    """Reported in https://github.com/ros-perception/image_pipeline/issues/278,
    https://github.com/ros-perception/image_common/issues/33: 8 numbers, `rational_polynomial`, under `cols: 5`.
    Tried: that calibration file.
    """
    import cv2

    images, stamp = messages()
    model = camera_model_from_info(info(D=D, distortion_model="rational_polynomial"))
    points = np.random.default_rng(1).uniform((-0.4, -0.3, 1.0), (0.4, 0.3, 1.2), (20, 3))
    seen = cv2.projectPoints(points, np.zeros(3), np.zeros(3), model.K, np.array(D))[0][:, 0]
    np.testing.assert_allclose(model.project(points), seen, atol=1e-9)
    np.testing.assert_allclose(model.rays(seen), points / points[:, 2:], atol=1e-9)
    message = images.camera_info_message(model, "f", stamp)
    assert message.distortion_model == "rational_polynomial" and same_camera(camera_model_from_info(message), model)


def test_colour_comes_red_first_and_depth_in_metres_whatever_the_encoding():
    """Reported in https://github.com/ros-naoqi/naoqi_driver/issues/77: depth comes as mono16 or 16UC1. Tried:
    mono16.
    """
    images, stamp = messages()
    colour = np.array([[[200, 20, 2]]], np.uint8)
    clear = np.insert(colour, 3, 255, axis=2)
    orders = {"rgb8": colour, "bgr8": colour[..., ::-1], "rgba8": clear, "bgra8": clear[..., [2, 1, 0, 3]]}
    for encoding, picture in orders.items():
        np.testing.assert_array_equal(
            images.colour_from_image(images.image_message(np.ascontiguousarray(picture), encoding, "f", stamp)), colour
        )
    millimetres = np.array([[1500]], np.uint16)
    for encoding, picture in (
        ("16UC1", millimetres),
        ("mono16", millimetres),
        ("32FC1", np.array([[1.5]], np.float32)),
    ):
        np.testing.assert_allclose(
            images.depth_from_image(images.image_message(picture, encoding, "f", stamp)), [[1.5]]
        )
    with pytest.raises(ValueError, match="mono8"):
        images.colour_from_image(images.image_message(np.zeros((1, 1), np.uint8), "mono8", "f", stamp))
    with pytest.raises(ValueError, match="rgb8"):
        images.depth_from_image(images.image_message(colour, "rgb8", "f", stamp))
