"""The window of the view for the headset: full screen on the display that is the Rift, else an ordinary window."""

from __future__ import annotations

import numpy as np
from python_qt_binding.QtCore import QRect, QSize, Qt, Signal
from python_qt_binding.QtGui import QColor, QImage, QPainter
from python_qt_binding.QtWidgets import QApplication, QWidget

from common.errors import DeviceError

RIFT = "Rift"
"""In the model name that the Rift itself tells the computer (EDID)."""
TITLE = "Leap Rig: headset"


def find_screen(application: QApplication, output: str):
    """Returns the screen of the output, or, without one, that of a Rift; None if there is no Rift.

    Raises:
        DeviceError: no screen has that name.
    """
    screens = application.screens()
    if output:
        for screen in screens:
            if screen.name() == output:
                return screen
        names = ", ".join(repr(screen.name()) for screen in screens)
        raise DeviceError(f"No display is on the output {output!r}; there are {names}.")
    return next((screen for screen in screens if RIFT in screen.model()), None)


class StereoScreen(QWidget):
    """Shows pictures, never stretched; Esc makes an ordinary window of a full screen, F11 toggles."""

    _came = Signal(object)

    def __init__(self) -> None:
        super().__init__()
        self.setWindowTitle(TITLE)
        self._picture: np.ndarray | None = None
        self._came.connect(self._take)

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
            # Qt would move it over whatever else is on the desk, such as the emergency button.
            if removed is screen:
                self._shrink()

        application.screenRemoved.connect(leave)

    def show_picture(self, picture: np.ndarray) -> None:
        """Shows a picture, shape (height, width, 3), uint8, red first; may be called from any thread."""
        self._came.emit(np.ascontiguousarray(picture))

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
        """Draws the newest picture as large as it fits, black around."""
        painter = QPainter(self)
        painter.fillRect(self.rect(), QColor(0, 0, 0))
        if self._picture is not None:
            height, width = self._picture.shape[:2]
            image = QImage(self._picture.data, width, height, 3 * width, QImage.Format_RGB888)
            size = QSize(width, height).scaled(self.size(), Qt.KeepAspectRatio)
            place = QRect(0, 0, size.width(), size.height())
            place.moveCenter(self.rect().center())
            painter.drawImage(place, image)
        painter.end()

    def _take(self, picture: np.ndarray) -> None:
        self._picture = picture
        self.update()

    def _shrink(self) -> None:
        self.unsetCursor()
        self.showNormal()
        self.resize(960, 540)
