"""The window of label_grasps.py: a depth image, on which grasps are drawn with the mouse, from finger to finger."""

from __future__ import annotations

import math
from pathlib import Path

import cv2
import numpy as np
from python_qt_binding.QtCore import QPointF, QRectF, Qt
from python_qt_binding.QtGui import QColor, QImage, QPainter, QPen, QPolygonF
from python_qt_binding.QtWidgets import QWidget

from common.errors import RigError
from grasping.lab.dataset.labelled_images import GraspRectangle, label_file, read_depth, read_grasps, write_grasps

BAND_PX = 56
SHORTEST_PX = 4.0  # a shorter line is a click, not a grasp
GREEN, AMBER, RED, WHITE = (QColor(name) for name in ("#30d060", "#ffb000", "#ff5050", "#ffffff"))
HELP = "drag from finger to finger; wheel: finger's breadth; Backspace: remove the last; arrows: other image; Esc: end"


def shown(depth: np.ndarray) -> np.ndarray:
    """Returns a depth image in colours, near is bright, no reading is black; shape (h, w, 3), uint8, BGR."""
    valid = np.isfinite(depth) & (depth > 0.0)
    if not valid.any():
        return np.zeros((*depth.shape, 3), np.uint8)
    near, far = np.percentile(depth[valid], (1.0, 99.0))
    grey = np.clip((far - np.where(valid, depth, far)) / max(far - near, 1e-3), 0.0, 1.0)
    colours = cv2.applyColorMap((255.0 * grey).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    colours[~valid] = 0
    return colours


class LabelWindow(QWidget):
    """Shows the images one after another; each change is stored at once in the image's label file."""

    def __init__(self, images: list[Path]) -> None:
        breadth_px = 20.0  # of a finger at first
        super().__init__()
        self._images = images
        self._breadth = breadth_px
        self._start: QPointF | None = None
        self._end = QPointF()
        self.setWindowTitle("Label grasps")
        self.setMouseTracking(True)
        self.resize(960, 720 + BAND_PX)
        self._open(0)

    @property
    def grasps(self) -> list[GraspRectangle]:
        return list(self._grasps)

    def _open(self, number: int) -> None:
        self._number, self._start, self._fault = number % len(self._images), None, ""
        self._grasps: list[GraspRectangle] = []
        path = self._images[self._number]
        self._colours = np.zeros((480, 640, 3), np.uint8)
        try:
            self._colours = np.ascontiguousarray(shown(read_depth(path)))
            if label_file(path).exists():
                self._grasps = read_grasps(label_file(path))
        except (RigError, OSError) as error:
            self._fault = str(error)
        self.update()

    def _store(self, grasps: list[GraspRectangle]) -> None:
        if self._fault:  # a file that cannot be read is not written over
            return
        path = label_file(self._images[self._number])
        try:
            write_grasps(path, grasps)
        except OSError as error:
            self._fault = f"{path} cannot be written: {error.strerror}. The grasp is not stored."
        else:
            self._grasps = grasps
        self.update()

    @property
    def _place(self) -> tuple[float, float, float]:
        """Left, top and scale of the image in the window."""
        h, w = self._colours.shape[:2]
        scale = min(self.width() / w, (self.height() - BAND_PX) / h)
        return 0.5 * (self.width() - scale * w), 0.5 * (self.height() - BAND_PX - scale * h), scale

    def _in_image(self, point: QPointF) -> tuple[float, float]:
        """Returns the pixel (column, row) at a point of the window, at most the border."""
        left, top, scale = self._place
        h, w = self._colours.shape[:2]
        column, row = (point.x() - left) / scale - 0.5, (point.y() - top) / scale - 0.5
        return float(np.clip(column, 0.0, w - 1.0)), float(np.clip(row, 0.0, h - 1.0))

    def _drawn(self) -> GraspRectangle | None:
        if self._start is None:
            return None
        a, b = self._in_image(self._start), self._in_image(self._end)
        return GraspRectangle.between(a, b, self._breadth) if math.dist(a, b) >= SHORTEST_PX else None

    def mousePressEvent(self, event) -> None:
        if event.button() == Qt.LeftButton and not self._fault:
            self._start = self._end = QPointF(event.pos())

    def mouseMoveEvent(self, event) -> None:
        if self._start is not None:
            self._end = QPointF(event.pos())
            self.update()

    def mouseReleaseEvent(self, event) -> None:
        if event.button() != Qt.LeftButton or self._start is None:
            return
        self._end = QPointF(event.pos())
        drawn, self._start = self._drawn(), None
        if drawn is not None:
            self._store([*self._grasps, drawn])
        self.update()

    def wheelEvent(self, event) -> None:
        breadth_step = 1.1  # factor of a step of the mouse wheel
        steps = event.angleDelta().y() / 120.0
        self._breadth = float(np.clip(self._breadth * breadth_step**steps, SHORTEST_PX, 200.0))
        self.update()

    def keyPressEvent(self, event) -> None:
        """Arrows, Backspace, Escape."""
        key = event.key()
        if key in (Qt.Key_Right, Qt.Key_Left):
            self._open(self._number + (1 if key == Qt.Key_Right else -1))
        elif key == Qt.Key_Backspace and self._grasps:
            self._store(self._grasps[:-1])
        elif key == Qt.Key_Escape:
            self.close()

    def paintEvent(self, _event) -> None:
        """Draws the image, the grasps and the text."""
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        painter.fillRect(self.rect(), QColor("#14181c"))
        left, top, scale = self._place
        h, w = self._colours.shape[:2]
        image = QImage(self._colours.data, w, h, 3 * w, QImage.Format_BGR888)
        painter.drawImage(QRectF(left, top, scale * w, scale * h), image)
        drawn = self._drawn()
        for grasp, colour in [*((g, GREEN) for g in self._grasps), *([(drawn, AMBER)] if drawn else [])]:
            corners = [QPointF(left + scale * (x + 0.5), top + scale * (y + 0.5)) for x, y in grasp.corners()]
            painter.setPen(QPen(colour, 1.0, Qt.DashLine))
            painter.drawPolygon(QPolygonF(corners))
            painter.setPen(QPen(colour, 4.0))  # the two fingers
            painter.drawLine(corners[0], corners[3])
            painter.drawLine(corners[1], corners[2])
        size = f"{drawn.opening:.0f} px open" if drawn else f"finger {self._breadth:.0f} px"
        count = f"{len(self._grasps)} grasp{'' if len(self._grasps) == 1 else 's'}"
        name = self._images[self._number].name
        lines = [f"{self._number + 1} of {len(self._images)}   {name}   {count}   {size}", self._fault or HELP]
        for n, (text, colour) in enumerate(zip(lines, (WHITE, RED if self._fault else WHITE))):
            painter.setPen(colour)
            painter.drawText(
                QRectF(10.0, self.height() - BAND_PX + 24.0 * n, self.width() - 20.0, 24.0), Qt.AlignVCenter, text
            )
