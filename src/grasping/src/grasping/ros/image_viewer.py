"""A window that shows one of the image topics that are published, chosen from a list."""

from __future__ import annotations

import sys
from xmlrpc.client import Fault

import cv2
import numpy as np
import rospy
from python_qt_binding.QtCore import Qt, QTimer
from python_qt_binding.QtGui import QImage, QPixmap
from python_qt_binding.QtWidgets import QApplication, QComboBox, QLabel, QSizePolicy, QVBoxLayout, QWidget
from sensor_msgs.msg import Image

from common.ros.images import COLOUR, array_from_image, colour_from_image
from common.ros.inputs import NodeInputs
from common.ros.node import run
from common.screen import check_screen

DRAW_MS = 100
IMAGE = "sensor_msgs/Image"


def picture(message: Image) -> np.ndarray:
    """Returns an image as it is shown, shape (h, w, 3), uint8, red first: measurements between their extremes, near or
    low ones bright, none (a whole number 0, or not finite) black. Raises ValueError for an unknown encoding, or
    incomplete data.
    """
    percentiles = (1.0, 99.0)  # of what is measured, the range that is shown
    if message.encoding in COLOUR:
        return np.ascontiguousarray(colour_from_image(message))
    array = array_from_image(message)
    if array.dtype == np.uint8:
        return np.repeat(array[..., None], 3, axis=2)
    valid = array > 0 if array.dtype == np.uint16 else np.isfinite(array)
    if not valid.any():
        return np.zeros((*array.shape, 3), np.uint8)
    low, high = np.percentile(array[valid], percentiles)
    grey = np.clip((high - np.where(valid, array, high)) / max(high - low, 1e-6), 0.0, 1.0)
    colours = cv2.applyColorMap((255.0 * grey).astype(np.uint8), cv2.COLORMAP_VIRIDIS)[..., ::-1]
    return np.ascontiguousarray(np.where(valid[..., None], colours, 0).astype(np.uint8))


def image_topics() -> list[str]:
    """Returns the names of the image topics that somebody publishes, none while the master does not answer."""
    try:
        return sorted(topic for topic, kind in rospy.get_published_topics() if kind == IMAGE)
    except (OSError, Fault, rospy.ROSException):
        return []


class ImageViewer(QWidget):
    """The window; `topic` is shown first, also before anybody publishes it."""

    def __init__(self, topic: str) -> None:
        topics_ms = 2000
        super().__init__()
        self.setWindowTitle("Images")
        self.resize(660, 540)
        self.choice = QComboBox()
        self.shown = QLabel()
        self.text = QLabel()
        self.shown.setAlignment(Qt.AlignCenter)
        self.shown.setSizePolicy(QSizePolicy.Ignored, QSizePolicy.Ignored)  # the window's size stays the user's
        layout = QVBoxLayout(self)
        for widget, stretch in ((self.choice, 0), (self.shown, 1), (self.text, 0)):
            layout.addWidget(widget, stretch)
        self._subscriber: rospy.Subscriber | None = None
        self._newest: Image | None = None
        self.choice.addItem(topic)
        self.choice.currentTextChanged.connect(self._switch)
        self._switch(topic)
        self._timers = [QTimer(self, interval=period) for period in (DRAW_MS, topics_ms)]
        for timer, work in zip(self._timers, (self.draw, self.list_topics)):
            timer.timeout.connect(work)
            timer.start()

    def list_topics(self) -> None:
        """Puts the published topics into the list, and keeps the chosen one."""
        chosen = self.choice.currentText()
        names = sorted({chosen, *image_topics()})
        if names != [self.choice.itemText(i) for i in range(self.choice.count())]:
            self.choice.blockSignals(True)
            self.choice.clear()
            self.choice.addItems(names)
            self.choice.setCurrentText(chosen)
            self.choice.blockSignals(False)

    def draw(self) -> None:
        """Draws the newest image, if there is a new one, or says why there is none."""
        message, self._newest = self._newest, None
        if message is None:
            fault = self._inputs.fault(logged=False)
            if fault:
                self.text.setText(fault)
            return
        try:
            array = picture(message)
        except ValueError as error:
            self._inputs.refused(error)
            self.text.setText(f"{self.choice.currentText()}: {error}.")
            return
        height, width = array.shape[:2]
        image = QImage(array.data, width, height, 3 * width, QImage.Format_RGB888)
        fitting = QPixmap.fromImage(image).scaled(self.shown.size(), Qt.KeepAspectRatio, Qt.SmoothTransformation)
        self.shown.setPixmap(fitting)
        self.text.setText(f"{width} x {height}, {message.encoding}")
        self._inputs.done()

    def _switch(self, topic: str) -> None:
        if self._subscriber is not None:
            self._subscriber.unregister()
        self._newest = None
        self.shown.clear()
        self._inputs = inputs = NodeInputs([topic])

        def take(message: Image) -> None:
            if inputs is self._inputs:  # else it is a late one of the previous topic
                self._newest = message

        self._subscriber = inputs.subscribe(topic, Image, take)
        self.draw()


def _run() -> None:
    check_screen("The window")
    application = QApplication(sys.argv[:1])
    window = ImageViewer(rospy.resolve_name("image"))
    window.show()
    end = QTimer(interval=DRAW_MS)  # its time-outs also give Python the chance to see signals, which shut ROS down
    end.timeout.connect(lambda: application.quit() if rospy.is_shutdown() else None)
    end.start()
    application.exec_()
    rospy.signal_shutdown("the window was closed")


def main() -> None:
    """Entry point of the script; `image:=TOPIC` is shown first."""
    run("image_viewer", _run)
