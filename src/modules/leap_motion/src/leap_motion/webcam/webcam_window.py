"""The window of the webcam tracker: image, skeletons, the box, what is missing, and the frame rate."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from python_qt_binding.QtCore import QPointF, QRectF, Qt, QTimer
from python_qt_binding.QtGui import QColor, QImage, QPainter, QPen
from python_qt_binding.QtWidgets import QWidget

from leap_motion.webcam.setups import BOX_CENTRE_MM

CHAINS = (*[[0, *range(i, i + 4)] for i in range(1, 21, 4)], [5, 9, 13, 17])
BOX_MM = 100.0  # half of its edge
CORNERS_MM = BOX_CENTRE_MM + BOX_MM * np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
EDGES = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
GREEN, AMBER, WHITE, BAND = QColor("#2e9e44"), QColor("#e0a030"), QColor("#ffffff"), QColor(20, 26, 32, 215)
BAND_PX = 84
HELP = "N: new neutral pose    Esc: quit"


class WebcamWindow(QWidget):
    """Shows what `view` returns, the program's newest TrackerView; `renew` takes a new neutral pose. A camera that
    looks at the person is shown as a mirror, `mirror`."""

    def __init__(self, view: Callable[[], object], renew: Callable[[], None], mirror: bool) -> None:
        refresh_ms = 33
        super().__init__()
        self._view = view
        self._renew = renew
        self._mirror = mirror
        self.setWindowTitle("Webcam tracker")
        self.resize(800, 600 + BAND_PX)
        self._timer = QTimer(self)
        self._timer.timeout.connect(self.update)
        self._timer.start(refresh_ms)

    def keyPressEvent(self, event) -> None:
        if event.key() == Qt.Key_N:
            self._renew()
        elif event.key() == Qt.Key_Escape:
            self.close()

    def paintEvent(self, _event) -> None:
        view, painter = self._view(), QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        painter.fillRect(self.rect(), QColor("#14181c"))
        if view.image is not None:
            self._draw_image(painter, view)
        self._draw_text(painter, view)

    def _draw_image(self, painter, view) -> None:
        height, width = view.image.shape[:2]
        scale = min(self.width() / width, (self.height() - BAND_PX) / height)
        left, top = 0.5 * (self.width() - scale * width), 0.5 * (self.height() - BAND_PX - scale * height)
        place = QRectF(left, top, scale * width, scale * height)
        image = np.ascontiguousarray(view.image[:, ::-1] if self._mirror else view.image)
        painter.drawImage(place, QImage(image.data, width, height, 3 * width, QImage.Format_BGR888))
        painter.setClipRect(place)

        def at(point) -> QPointF:
            x = 1.0 - point[0] if self._mirror else point[0]
            return QPointF(place.x() + x * place.width(), place.y() + point[1] * place.height())

        corners = view.camera.in_camera(CORNERS_MM)
        if view.known and (corners[:, 2] > 10.0).all():
            painter.setPen(QPen(AMBER, 1.5, Qt.DashLine))
            seen = view.lens.landmarks(corners, view.image.shape)
            for a, b in EDGES:
                painter.drawLine(at(seen[a]), at(seen[b]))
        for landmarks in view.landmarks:
            painter.setPen(QPen(AMBER if view.remark else GREEN, 3.0))
            for chain in CHAINS:
                for a, b in zip(chain, chain[1:]):
                    painter.drawLine(at(landmarks[a]), at(landmarks[b]))
            painter.setPen(Qt.NoPen)
            painter.setBrush(WHITE)
            for point in landmarks:
                painter.drawEllipse(at(point), 3.0, 3.0)
        painter.setClipping(False)

    def _draw_text(self, painter, view) -> None:
        band = QRectF(0.0, self.height() - BAND_PX, self.width(), BAND_PX)
        painter.fillRect(band, BAND)
        painter.setPen(AMBER if view.remark else GREEN)
        font = painter.font()
        font.setPointSize(12)
        painter.setFont(font)
        text = view.remark or "The hand is tracked."
        painter.drawText(band.adjusted(12, 6, -12, -28), int(Qt.AlignLeft | Qt.AlignVCenter | Qt.TextWordWrap), text)
        font.setPointSize(9)
        painter.setFont(font)
        painter.setPen(WHITE)
        where = "".join(f"    hand at {distance / 10:.0f} cm" for distance in view.distances)
        low = band.adjusted(12, 58, -12, -4)
        painter.drawText(low, int(Qt.AlignLeft | Qt.AlignVCenter), f"{view.rate:.0f} frames per second{where}")
        painter.drawText(low, int(Qt.AlignRight | Qt.AlignVCenter), HELP)
