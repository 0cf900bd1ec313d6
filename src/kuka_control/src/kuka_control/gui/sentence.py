"""Texts of the control panel: what a controller says is shown as it is, and never changes the panel's size."""

from __future__ import annotations

import html

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import QLabel, QSizePolicy

from kuka_control.gui.panel_state import Tone

FRAME_PX = 18
"""Height of frame and padding above and below the text."""

UNBOUNDED_PX = 10_000


class Sentence(QLabel):
    """A sentence in a frame with room for `lines` lines; a longer one is cut, and whole in the tool tip.

    Attributes:
        full: the whole sentence.
    """

    def __init__(self, lines: int) -> None:
        super().__init__()
        self._lines = lines
        self.setTextFormat(Qt.PlainText)
        self.setWordWrap(True)
        self.setAlignment(Qt.AlignTop | Qt.AlignLeft)
        self.setSizePolicy(QSizePolicy.Ignored, QSizePolicy.Fixed)
        self.full = ""
        self.show_text("", Tone.NORMAL)

    def show_text(self, text: str, tone: Tone) -> None:
        """Shows the text in the colour of its tone."""
        shown = tone.value if text else "silent"
        if self.property("tone") != shown:
            self.setProperty("tone", shown)
            self.style().unpolish(self)  # Qt looks at properties only then
            self.style().polish(self)
        if text != self.full:
            self.full = text
            self._fit()

    def resizeEvent(self, event) -> None:
        """Fits the text to the new size."""
        super().resizeEvent(event)
        self._fit()

    def changeEvent(self, event) -> None:
        """Makes room for the lines in a new font."""
        super().changeEvent(event)
        self.setFixedHeight(self._height_of("\n" * (self._lines - 1)) + FRAME_PX)

    def _fit(self) -> None:
        shown = self.full
        while shown and not self._fits(shown):
            shown = shown[: -2 - len(shown) // 20].rstrip() + "…"
        self.setText(shown)
        self.setToolTip("" if shown == self.full else f"<p>{html.escape(self.full)}</p>")

    def _fits(self, text: str) -> bool:
        return self._height_of(text) <= self._height_of("\n" * (self._lines - 1))

    def _height_of(self, text: str) -> int:
        """Returns the height of the text at the present width [px]; a word too long for a line counts as too high."""
        width = self.contentsRect().width()
        flags = int(Qt.TextWordWrap | Qt.AlignTop | Qt.AlignLeft)
        needed = self.fontMetrics().boundingRect(0, 0, width, UNBOUNDED_PX, flags, text)
        return needed.height() if needed.width() <= width else UNBOUNDED_PX


def label(text: str = "", name: str = "") -> QLabel:
    """Returns a label that shows its text as it is."""
    widget = QLabel(text)
    widget.setObjectName(name)
    widget.setTextFormat(Qt.PlainText)
    return widget
