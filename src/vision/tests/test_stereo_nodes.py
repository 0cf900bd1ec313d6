"""The window of stereo_view and the pages of stereo_web, in Qt, in browsers and on sockets, and how the nodes exit."""

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
from stereo_camera import REMAPS, Camera, middle

pytest.importorskip("rospy")
pytestmark = pytest.mark.ros

PAGE = str(Path(__file__).parents[1] / "web" / "headset.html")
PATIENT = {"age_after": 4.0, "depth_gap": 1.0}
"""A busy machine takes longer for an image than the 0.5 s after which its age is shown, and brings its depth later."""


@pytest.fixture
def camera(ros):
    made = Camera()
    yield made
    made.close()


@pytest.fixture
def offscreen(monkeypatch):
    monkeypatch.setenv("QT_QPA_PLATFORM", "offscreen")


def start_view(ros, output=""):
    import rospy

    rospy.set_param("stereo_view", {"view": load("stereo_view.yaml"), "output": output})
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


class TestWindow:
    def test_both_eyes_see_the_camera_until_ctrl_c(self, ros, camera, offscreen, processes, wait_until):
        from sensor_msgs.msg import Image

        images = ros.record("stereo_view/image", Image)
        node = start_view(ros)

        def shown():
            camera.publish()
            return images

        wait_until(shown, 30.0, "an image", poll=0.1)
        assert (images[0].width, images[0].height, images[0].encoding) == (1920, 1080, "rgb8")
        for left, right in (middle(images[0])[:2], middle(images[0])[2:]):
            assert left[0] > left[2] == 0 and right[2] > right[0] == 0
        assert processes.end(node, timeout=30.0) == 0
        assert "Traceback" not in node.log_path.read_text()

    def test_an_unknown_output_ends_it_with_a_sentence(self, ros, offscreen):
        node = start_view(ros, output="HDMI-7")
        assert node.wait(60.0) == 1
        log = node.log_path.read_text()
        assert "'HDMI-7'" in log and "Traceback" not in log


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

    def test_an_address_that_is_not_ours_ends_it_with_a_sentence(self, ros):
        import rospy

        web = {"host": "192.0.2.1", "port": 0, "page": PAGE, "certificate": "", "key": ""}
        rospy.set_param("stereo_web", {"view": load("stereo_view.yaml"), "web": web})
        node = ros.run("vision", "stereo_web_node.py")
        assert node.wait(60.0) == 1
        log = node.log_path.read_text()
        assert "Cannot serve the page on 192.0.2.1:0" in log and "Traceback" not in log

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
