"""The nodes stereo_view and stereo_web: what they show, what they show when the camera stops, and how they end."""

from __future__ import annotations

import json
import shutil
import ssl
import subprocess
import urllib.error
import urllib.request
from pathlib import Path

import cv2
import numpy as np
import pytest
from chromium import browser
from depth_scene import RGB, load

from common.frames import RGB_OPTICAL

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

PAGE = str(Path(__file__).parents[1] / "web" / "headset.html")
DEPTH_MM = 800
PATIENT = {"age_after": 4.0, "depth_gap": 1.0}
"""A busy machine takes longer for an image than the 0.5 s after which its age is shown, and brings its depth later."""
REMAPS = [f"{name}:=camera/{name}" for name in ("rgb/image_raw", "rgb/camera_info", "depth/image_raw")]


class Camera:
    """Publishes images whose left half is red and whose right half is blue."""

    def __init__(self):
        import rospy
        from sensor_msgs.msg import CameraInfo, Image

        self._colour = np.zeros((RGB.height, RGB.width, 3), np.uint8)
        self._colour[:, : RGB.width // 2, 0] = 200
        self._colour[:, RGB.width // 2 :, 2] = 200
        self.publishers = {
            name: rospy.Publisher(f"camera/{name}", kind, queue_size=1)
            for name, kind in (("rgb/image_raw", Image), ("rgb/camera_info", CameraInfo), ("depth/image_raw", Image))
        }

    def publish(self, depth=True):
        """Publishes one image."""
        import rospy

        from common.ros.images import camera_info_message, image_message

        stamp = rospy.Time.now()
        if depth:
            image = np.full((RGB.height, RGB.width), DEPTH_MM, np.uint16)
            self.publishers["depth/image_raw"].publish(image_message(image, "16UC1", RGB_OPTICAL, stamp))
        self.publishers["rgb/camera_info"].publish(camera_info_message(RGB, RGB_OPTICAL, stamp))
        self.publishers["rgb/image_raw"].publish(image_message(self._colour, "rgb8", RGB_OPTICAL, stamp))

    def watched(self):
        """Whether somebody takes the images."""
        return self.publishers["rgb/image_raw"].get_num_connections() > 0

    def close(self):
        for publisher in self.publishers.values():
            publisher.unregister()


@pytest.fixture
def camera(ros):
    made = Camera()
    yield made
    made.close()


@pytest.fixture
def offscreen(monkeypatch):
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")


def status(ros, name):
    """Returns a function that gives the sentence of a node's last status."""
    from diagnostic_msgs.msg import DiagnosticArray

    arrays = ros.record("/diagnostics", DiagnosticArray)
    return lambda: ([s.message for array in arrays for s in array.status if s.name == name] or [""])[-1]


def start_view(ros, output="", **changes):
    import rospy

    rospy.set_param("stereo_view", {"view": {**load("stereo_view.yaml"), **PATIENT, **changes}, "output": output})
    return ros.run("vision", "stereo_view_node.py", *REMAPS)


def start_web(ros, wait_until, **changes):
    """Starts the node and returns it and the address of its page."""
    import rospy

    web = {"host": "127.0.0.1", "port": 0, "page": PAGE, "certificate": "", "key": "", **changes}
    rospy.set_param("stereo_web", {"view": {**load("stereo_view.yaml"), **PATIENT, "lens": "none"}, "web": web})
    node = ros.run("vision", "stereo_web_node.py", *REMAPS)

    def address():
        assert node.poll() is None, node.log_path.read_text()
        words = node.log_path.read_text().split("The view is at ")
        return words[1].split("\x1b")[0].split()[0] if len(words) > 1 else None

    return node, wait_until(address, 30.0, "the address of the page")


def middle(message):
    """The colour above the middle of each eye's image, left and right of its middle column."""
    from common.ros.images import array_from_image

    image = array_from_image(message)
    return [image[420, c] for c in (350, 600, 960 + 350, 960 + 600)]


class TestWindow:
    def test_both_eyes_see_the_camera_and_the_age_when_it_stops(self, ros, camera, offscreen, wait_until):
        from sensor_msgs.msg import Image

        images, sentence = ros.record("stereo_view/image", Image), status(ros, "stereo_view")
        start_view(ros)

        def shown():
            camera.publish()
            return sentence() == "Shows images." and len(images) > 0

        wait_until(shown, 30.0, "an image", poll=0.1)
        assert (images[-1].width, images[-1].height, images[-1].encoding) == (1920, 1080, "rgb8")
        last = images[-1].header.stamp
        wait_until(lambda: "s old" in sentence(), 10.0, "the sentence about the age")
        wait_until(lambda: middle(images[-1])[0][0] < 100, 10.0, "the dark image")
        assert images[-1].header.stamp >= last
        for left, right in (middle(images[-1])[:2], middle(images[-1])[2:]):
            assert left[0] == 80 and left[2] == 0 and right[2] == 80 and right[0] == 0
        wait_until(shown, 30.0, "images again", poll=0.1)

    def test_without_depth_it_shows_the_image_twice_and_says_so(self, ros, camera, offscreen, wait_until):
        sentence = status(ros, "stereo_view")
        start_view(ros)

        def said():
            camera.publish(depth=False)
            return sentence().startswith("Shows the same image twice: no depth")

        wait_until(said, 30.0, "the sentence", poll=0.1)

    def test_torn_images_are_not_shown_and_do_not_count_as_new(self, ros, camera, offscreen, wait_until):
        import rospy
        from sensor_msgs.msg import Image

        sentence = status(ros, "stereo_view")
        node = start_view(ros)

        def torn():
            torn = Image(width=640, height=480, encoding="rgb8", step=1920, data=b"short")
            torn.header.stamp = rospy.Time.now()
            camera.publishers["rgb/image_raw"].publish(torn)
            return "s old" in sentence()

        def shown():
            camera.publish()
            return sentence() == "Shows images."

        wait_until(shown, 30.0, "an image", poll=0.1)
        wait_until(torn, 30.0, "the sentence about the age", poll=0.1)
        assert "5 bytes" in node.log_path.read_text()
        wait_until(shown, 30.0, "an image", poll=0.1)

    @pytest.mark.parametrize(
        ("changes", "sentence"),
        [
            ({"lens": "vive", "colour": 1}, "~view/colour is not a known key"),
            ({"output": "HDMI-7"}, "'HDMI-7'"),
        ],
    )
    def test_it_ends_with_a_sentence(self, ros, offscreen, changes, sentence):
        node = start_view(ros, **changes)
        assert node.wait(60.0) == 1
        log = node.log_path.read_text()
        assert sentence in log and "Traceback" not in log

    def test_without_a_screen_it_ends_with_a_sentence(self, ros, monkeypatch):
        for name in ("DISPLAY", "WAYLAND_DISPLAY", "QT_QPA_PLATFORM"):
            monkeypatch.delenv(name, raising=False)
        node = start_view(ros)
        assert node.wait(60.0) == 1
        assert "needs a screen" in node.log_path.read_text()

    def test_ctrl_c_ends_it(self, ros, camera, offscreen, processes, wait_until):
        node = start_view(ros)
        wait_until(camera.watched, 30.0, "the node")
        assert processes.end(node, timeout=30.0) == 0
        assert "Traceback" not in node.log_path.read_text()


class TestWeb:
    def ask(self, connection):
        connection.send("next")
        said = json.loads(connection.recv(timeout=30.0))
        return said, connection.recv(timeout=30.0) if said["picture"] else None

    def test_a_page_gets_each_image_once_and_the_camera_rests_without_a_page(self, ros, camera, wait_until):
        import rospy
        from websockets.sync.client import connect

        from rig_msgs.msg import OperatorRow, OperatorView

        view = rospy.Publisher("operator_view/rows", OperatorView, queue_size=1)
        _, address = start_web(ros, wait_until)
        with urllib.request.urlopen(address, timeout=30.0) as answer:
            assert answer.headers["Content-Type"].startswith("text/html")
            assert answer.read() == Path(PAGE).read_bytes()
        assert not camera.watched()
        with connect(address.replace("http", "ws") + "pictures") as connection:
            wait_until(camera.watched, 30.0, "the node to look")

            def image():
                camera.publish()
                said, jpeg = self.ask(connection)
                return said["picture"] and said["deep"] and (said, jpeg)

            said, jpeg = wait_until(image, 30.0, "an image")
            both = cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR)[..., ::-1]
            assert both.shape == (RGB.height, 2 * RGB.width, 3)
            assert both[240, 200, 0] > 150 and both[240, 1280 - 200, 2] > 150
            left, right, up, down = said["tangents"]
            assert (left + right) * RGB.P[0, 0] == pytest.approx(640.0)
            assert (up + down) * RGB.P[1, 1] == pytest.approx(480.0)
            wait_until(lambda: self.ask(connection)[0] == {"picture": False}, 30.0, "silence")
            rows = [dict(name="Hand", text="waiting", tone="good", kind="ticks", labels=["flat"], values=[1.0])]

            def shown():
                view.publish(OperatorView(rows=[OperatorRow(**row) for row in rows]))
                return self.ask(connection)[0].get("rows")

            assert wait_until(shown, 30.0, "what the operator sees") == rows
            wait_until(lambda: "rows" not in self.ask(connection)[0], 30.0, "the view's silence")
        wait_until(lambda: not camera.watched(), 30.0, "the camera's rest")

    def test_ctrl_c_ends_it_while_a_page_looks(self, ros, camera, processes, wait_until):
        from websockets.sync.client import connect

        node, address = start_web(ros, wait_until)
        with connect(address.replace("http", "ws") + "pictures"):
            wait_until(camera.watched, 30.0, "the node to look")
            assert processes.end(node, timeout=30.0) == 0
        assert "Traceback" not in node.log_path.read_text()

    @pytest.mark.skipif(not shutil.which("openssl"), reason="openssl is not installed")
    def test_with_a_certificate_the_page_comes_by_https(self, ros, wait_until, tmp_path):
        from websockets.sync.client import connect

        key, certificate = str(tmp_path / "key.pem"), str(tmp_path / "certificate.pem")
        subprocess.run(
            ["openssl", "req", "-x509", "-newkey", "rsa:2048", "-nodes", "-days", "1", "-subj", "/CN=localhost",
             "-addext", "subjectAltName=IP:127.0.0.1", "-keyout", key, "-out", certificate],
            check=True, capture_output=True, timeout=60.0,
        )  # fmt: skip
        _, address = start_web(ros, wait_until, certificate=certificate, key=key)
        assert address.startswith("https://")
        trust = ssl.create_default_context(cafile=certificate)
        with urllib.request.urlopen(address, timeout=30.0, context=trust) as answer:
            assert answer.read() == Path(PAGE).read_bytes()
        socket = address.replace("https", "wss") + "pictures"
        with connect(socket, ssl=trust, origin=address.rstrip("/")) as connection:
            assert self.ask(connection)[0] == {"picture": False}

    def test_other_paths_and_other_sites_get_nothing(self, ros, wait_until):
        from websockets.exceptions import InvalidStatus
        from websockets.sync.client import connect

        _, address = start_web(ros, wait_until)
        for path, headers, code in (
            ("secret", {}, 404),
            ("../etc/passwd", {}, 404),
            ("", {"Host": "evil.example:80"}, 403),
        ):
            with pytest.raises(urllib.error.HTTPError) as caught:
                urllib.request.urlopen(urllib.request.Request(address + path, headers=headers), timeout=30.0)
            assert caught.value.code == code
        with pytest.raises(InvalidStatus):
            connect(address.replace("http", "ws") + "pictures", origin="http://evil.example")

    @pytest.mark.parametrize(
        ("changes", "sentence"),
        [
            ({"host": "192.0.2.1"}, "Cannot serve the page on 192.0.2.1:0"),
            ({"certificate": "/nowhere.pem"}, "certificate and key"),
        ],
    )
    def test_it_ends_with_a_sentence(self, ros, wait_until, changes, sentence):
        import rospy

        web = {"host": "127.0.0.1", "port": 0, "page": PAGE, "certificate": "", "key": "", **changes}
        rospy.set_param("stereo_web", {"view": load("stereo_view.yaml"), "web": web})
        node = ros.run("vision", "stereo_web_node.py")
        assert node.wait(60.0) == 1
        log = node.log_path.read_text()
        assert sentence in log and "Traceback" not in log

    @pytest.mark.skipif(not shutil.which("chromium"), reason="chromium is not installed")
    def test_the_page_shows_images_and_their_age_and_paints_each_eye_its_own_half(
        self, ros, camera, wait_until, tmp_path
    ):
        _, address = start_web(ros, wait_until)
        with browser(address, tmp_path, wait_until) as evaluate:

            def shown():
                camera.publish()
                return (
                    evaluate("window.shown > 3 && document.getElementById('state').textContent")
                    == "each eye its own view"
                )

            wait_until(shown, 30.0, "images on the page", poll=0.1)
            assert evaluate("Array.from(pen.getImageData(200, 240, 1, 1).data)")[0] > 150
            sees = evaluate(EYES)
            assert sees["left"] != sees["right"]
            assert [colour[0] > 150 for colour in sees["left"]] == [True, False]
            assert evaluate("navigator.xr !== undefined && isSecureContext")
            age = "document.getElementById('state').textContent.endsWith('s old')"
            wait_until(lambda: evaluate(age), 30.0, "the age", poll=0.1)


EYES = """(() => {
  const gl = Object.assign(document.createElement("canvas"), {width: 100, height: 100}).getContext("webgl");
  const paint = painter(gl), pixel = new Uint8Array(4), found = {};
  const turn = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, 1, 0,  0, 0, 0, 1];
  const projection = [1, 0, 0, 0,  0, 1, 0, 0,  0, 0, -1, -1,  0, 0, -0.2, 0];
  paint.load();
  for (const right of [false, true]) {
    gl.clear(gl.COLOR_BUFFER_BIT);
    paint.paint(projection, turn, right);
    found[right ? "right" : "left"] = [47, 53].map(x => {
      gl.readPixels(x, 50, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, pixel);
      return Array.from(pixel);
    });
  }
  return found;
})()"""
"""What the two eyes see left and right of straight ahead."""
