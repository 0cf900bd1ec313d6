"""Drawing grasps with the mouse: on the window itself, and the program on a screen, with a mouse from outside."""

from __future__ import annotations

import re
import shutil
import subprocess

import cv2
import numpy as np
import pytest

from grasping.lab.dataset import labelled_images as li

LONG_S = 60.0


@pytest.fixture(name="folder")
def folder_fixture(tmp_path):
    for number in range(2):
        depth = np.full((480, 640), 700, np.uint16)
        depth[200:280, 300:340] = 640
        cv2.imwrite(str(tmp_path / f"thing_{number}.png"), depth)
    return tmp_path


@pytest.fixture(name="window")
def window_fixture(application, folder):
    from grasping.lab.label_window import LabelWindow

    window = LabelWindow(li.depth_images(folder))
    window.show()
    return window


@pytest.fixture(name="drag")
def drag_fixture(window):
    from python_qt_binding.QtCore import QEvent, QPointF, Qt
    from python_qt_binding.QtGui import QMouseEvent

    def drag(*pixels):
        """From the first pixel (column, row) of the image over the others."""
        left, top, scale = window._place
        points = [QPointF(left + scale * (x + 0.5), top + scale * (y + 0.5)) for x, y in pixels]

        def event(kind, point, buttons):
            return QMouseEvent(kind, point, Qt.LeftButton, buttons, Qt.NoModifier)

        window.mousePressEvent(event(QEvent.MouseButtonPress, points[0], Qt.LeftButton))
        for point in points:
            window.mouseMoveEvent(event(QEvent.MouseMove, point, Qt.LeftButton))
        window.mouseReleaseEvent(event(QEvent.MouseButtonRelease, points[-1], Qt.NoButton))

    return drag


@pytest.fixture(name="key")
def key_fixture(window):
    from python_qt_binding.QtCore import QEvent, Qt
    from python_qt_binding.QtGui import QKeyEvent

    return lambda name: window.keyPressEvent(QKeyEvent(QEvent.KeyPress, getattr(Qt, f"Key_{name}"), Qt.NoModifier))


def test_a_drag_is_a_grasp_between_its_ends_and_is_stored(window, drag, folder):
    drag((290.0, 240.0), (400.0, 10.0), (350.0, 240.0))
    (grasp,) = li.read_grasps(folder / "thing_0.grasps.json")
    assert (grasp.row, grasp.column) == pytest.approx((240.0, 320.0), abs=1.0)
    assert grasp.angle == pytest.approx(0.0, abs=0.02) and grasp.opening == pytest.approx(60.0, abs=1.5)
    drag((300.0, 250.0), (340.0, 210.0))
    assert [g.angle for g in li.read_grasps(folder / "thing_0.grasps.json")] == pytest.approx(
        [0.0, np.pi / 4], abs=0.05
    )
    assert window.grasps == li.read_grasps(folder / "thing_0.grasps.json")


def test_a_click_is_no_grasp_and_a_drag_out_of_the_image_ends_at_its_border(window, drag, folder):
    drag((300.0, 240.0), (301.0, 240.0))
    assert not (folder / "thing_0.grasps.json").exists()
    drag((600.0, 240.0), (900.0, 240.0))
    assert window.grasps[0].column + 0.5 * window.grasps[0].opening == pytest.approx(639.0, abs=1.0)


def test_the_last_grasp_is_removed_and_images_keep_theirs(window, drag, key, folder):
    drag((290.0, 240.0), (350.0, 240.0))
    drag((290.0, 260.0), (350.0, 260.0))
    key("Backspace")
    key("Right")
    assert window.grasps == []
    drag((290.0, 210.0), (350.0, 210.0))
    for name, row in (("Right", 240.0), ("Left", 210.0)):
        key(name)
        assert [g.row for g in window.grasps] == pytest.approx([row], abs=1.0)


def test_a_label_file_that_cannot_be_read_is_kept_as_it_is(window, drag, key, folder):
    (folder / "thing_1.grasps.json").write_text("something else")
    key("Right")
    drag((290.0, 240.0), (350.0, 240.0))
    key("Backspace")
    assert (folder / "thing_1.grasps.json").read_text() == "something else" and window.grasps == []


@pytest.mark.ros
@pytest.mark.long
@pytest.mark.skipif(not (shutil.which("Xvfb") and shutil.which("xdotool")), reason="xvfb and xdotool are not installed")
def test_the_program_on_a_screen(folder, processes, wait_until):
    server = processes.start("Xvfb", "-displayfd", "1", "-screen", "0", "1280x1024x24", "-noreset", "-nolisten", "tcp")
    number = wait_until(lambda: re.search(r"^(\d+)$", server.log_path.read_text(), re.M), LONG_S, "the screen")
    env = {"DISPLAY": f":{number[1]}", "QT_QPA_PLATFORM": "xcb"}
    program = processes.start("rosrun", "grasping", "label_grasps.py", str(folder), env=env)

    def mouse(*words):
        return subprocess.run(["xdotool", *map(str, words)], env=env, capture_output=True, text=True).stdout.strip()

    window = wait_until(lambda: mouse("search", "--onlyvisible", "--name", "Label grasps"), LONG_S, "the window")

    def drawn():
        mouse("mousemove", "--window", window, 400, 360, "mousedown", 1)
        mouse("mousemove", "--window", window, 500, 360, "mouseup", 1)
        return (folder / "thing_0.grasps.json").exists()

    wait_until(drawn, LONG_S, "a stored grasp")
    grasp = li.read_grasps(folder / "thing_0.grasps.json")[0]
    assert grasp.opening == pytest.approx(100.0 / 1.5, abs=3.0) and abs(grasp.angle) < 0.05
    assert program.poll() is None, program.log_path.read_text()
