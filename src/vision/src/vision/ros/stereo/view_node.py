"""The node stereo_view: shows the headset view in a window and on the topic stereo_view/image. The window is full
screen on the display that is the Rift, otherwise an ordinary window."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import cv2
import numpy as np
import rospy
from python_qt_binding.QtCore import QRect, QSize, Qt, QTimer, Signal
from python_qt_binding.QtGui import QColor, QImage, QPainter
from python_qt_binding.QtWidgets import QApplication, QWidget
from sensor_msgs.msg import Image

from common import clock
from common.errors import DeviceError
from common.ros.diagnostics import Diagnostics
from common.ros.images import image_message
from common.ros.node import while_running
from common.ros.params import private_config
from common.screen import check_screen
from vision.ros.stereo.eye_images import StereoImageSource
from vision.stereo.view import StereoViewConfig, WindowConfig

FRAME = "headset"
RIFT = "Rift"  # part of the model name that the Rift reports to the computer (EDID)
TITLE = "Leap Rig: headset"


def find_screen(application: QApplication, output: str):
    """Returns the screen of `output`, or if it is empty the Rift's or None; raises DeviceError for an unknown one."""
    screens = application.screens()
    if output:
        for screen in screens:
            if screen.name() == output:
                return screen
        names = ", ".join(repr(screen.name()) for screen in screens)
        raise DeviceError(f"No display is on the output {output!r}; use one of {names} (xrandr lists them).")
    return next((screen for screen in screens if RIFT in screen.model()), None)


class StereoScreen(QWidget):
    """Shows images without stretching them; Esc leaves the full screen, F11 toggles it."""

    _arrived = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.setWindowTitle(TITLE)
        self._image: np.ndarray | None = None
        self._arrived.connect(self._on_image)

    def show_on(self, application: QApplication, screen) -> None:
        """Opens the window, full screen on the screen unless that is None."""
        if screen is None:
            self.resize(960, 540)
            self.show()
            return
        self.setGeometry(screen.geometry())
        self.setCursor(Qt.BlankCursor)
        self.showFullScreen()

        def leave(removed) -> None:
            # Qt would move it over the other windows on the desk, such as the emergency button.
            if removed is screen:
                self._shrink()

        application.screenRemoved.connect(leave)

    def show_image(self, image: np.ndarray) -> None:
        """Shows an RGB image, shape (height, width, 3), uint8; may be called from any thread."""
        self._arrived.emit(np.ascontiguousarray(image))

    def keyPressEvent(self, event) -> None:
        """Esc and F11."""
        if event.key() == Qt.Key_F11 and not self.isFullScreen():
            self.setCursor(Qt.BlankCursor)
            self.showFullScreen()
        elif event.key() in (Qt.Key_Escape, Qt.Key_F11):
            self._shrink()
        else:
            super().keyPressEvent(event)

    def paintEvent(self, _) -> None:
        """Draws the newest image as large as it fits, on black."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(0, 0, 0))
        if self._image is not None:
            height, width = self._image.shape[:2]
            image = QImage(self._image.data, width, height, 3 * width, QImage.Format_RGB888)
            area = QRect(0, 0, 0, 0)
            area.setSize(QSize(width, height).scaled(self.size(), Qt.KeepAspectRatio))
            area.moveCenter(self.rect().center())
            painter.drawImage(area, image)
        painter.end()

    def _on_image(self, image: np.ndarray) -> None:
        self._image = image
        self.update()

    def _shrink(self) -> None:
        self.unsetCursor()
        self.showNormal()
        self.resize(960, 540)


def main() -> None:
    poll_ms = 100
    check_screen("The headset view")
    cv2.setNumThreads(1)  # images this small take more processor time when shared
    output = private_config(WindowConfig, others=("view",)).output
    config = private_config(StereoViewConfig, "view")
    application = QApplication(sys.argv[:1])
    screen = find_screen(application, output)
    rospy.loginfo("Shows the view %s.", f"on {screen.name()}" if screen else "in a window: no display is a Rift")
    window = StereoScreen()
    window.show_on(application, screen)
    images = StereoImageSource(config)
    images.subscribe(True)
    stop = clock.Event()
    pool = ThreadPoolExecutor(1, "draw")
    drawing = pool.submit(_draw, images, window, stop)
    Diagnostics("stereo_view", images.diagnose)
    poll = QTimer()
    # Its time-outs also give Python the chance to handle signals.
    poll.timeout.connect(lambda: application.quit() if rospy.is_shutdown() or drawing.done() else None)
    poll.start(poll_ms)
    application.exec_()
    poll.stop()
    stop.set()
    drawing.result()
    pool.shutdown()


def _draw(images: StereoImageSource, window: StereoScreen, stop: clock.Event) -> None:
    refresh_s = 0.2  # period at which an old image is drawn again with its new age
    publisher = rospy.Publisher("stereo_view/image", Image, queue_size=1)
    while not stop.is_set():
        shown = images.wait(refresh_s)
        if shown is None:
            continue
        image = shown.view.screen.draw(shown.eyes.left, shown.eyes.right)
        window.show_image(image)
        if publisher.get_num_connections():
            with while_running():
                publisher.publish(image_message(image, "rgb8", FRAME, shown.stamp))
