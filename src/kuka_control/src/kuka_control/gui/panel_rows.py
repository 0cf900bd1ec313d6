"""The rows of the operator's view as a Qt widget: a line of text each, and ticks or bars behind or below it."""

from __future__ import annotations

import html

from python_qt_binding.QtCore import QRect, QSize, Qt
from python_qt_binding.QtGui import QColor, QPainter
from python_qt_binding.QtWidgets import QSizePolicy, QWidget

from common.operator_rows import BARS, COLOURS, TICKS, Row, RowTone

GAP_PX = 3
BACKGROUND = QColor("#e4e7eb")


class OperatorRows(QWidget):
    """Draws the rows; a long text without items gets two lines, a longer one is cut, and whole in the tool tip."""

    def __init__(self) -> None:
        super().__init__()
        self._rows: tuple[Row, ...] = ()
        policy = QSizePolicy(QSizePolicy.Ignored, QSizePolicy.Fixed)
        policy.setHeightForWidth(True)
        self.setSizePolicy(policy)

    def show_rows(self, rows: tuple[Row, ...]) -> None:
        if rows == self._rows:
            return
        self._rows = rows
        self.setToolTip("<br>".join(html.escape(f"{row.name}: {row.text}") for row in rows))
        self.setAccessibleDescription("\n".join(_spoken(row) for row in rows))
        self.setFixedHeight(max(1, self._lay_out(None)))
        self.update()

    def sizeHint(self) -> QSize:
        """Has no width of its own."""
        return QSize(0, self.minimumHeight())

    def resizeEvent(self, event) -> None:
        super().resizeEvent(event)
        self.setFixedHeight(max(1, self._lay_out(None)))

    def paintEvent(self, _event) -> None:
        painter = QPainter(self)
        painter.setRenderHint(QPainter.Antialiasing)
        self._lay_out(painter)
        painter.end()

    def _lay_out(self, painter: QPainter | None) -> int:
        """Draws the rows, if there is a painter, and returns their height [px]."""
        name_em = 5  # width of the column of names, in heights of the font
        bar_em = 3
        two_lines = 1.8  # widths of the words that two lines take: a line breaks before a long word
        metrics = self.fontMetrics()
        line, y = metrics.height() + GAP_PX, 0
        left = name_em * metrics.height()
        room = max(1, self.width() - left)
        for row in self._rows:
            lines = 2 if not row.labels and metrics.horizontalAdvance(row.text) > room else 1
            if painter is not None:
                painter.setPen(QColor(COLOURS[RowTone.STALE if row.tone is RowTone.STALE else RowTone.NORMAL]))
                painter.drawText(QRect(0, y, left, line), Qt.AlignVCenter, row.name)
                painter.setPen(QColor(COLOURS[row.tone]))
                text = metrics.elidedText(row.text, Qt.ElideRight, room if lines == 1 else round(two_lines * room))
                painter.drawText(QRect(left, y, room, lines * line), Qt.AlignVCenter | Qt.TextWordWrap, text)
            if row.labels:
                extra = bar_em * metrics.height() if row.kind == BARS else metrics.height()
                cell = max(metrics.horizontalAdvance(label) for label in row.labels) + extra + 4 * GAP_PX
                x = left + metrics.horizontalAdvance(row.text) + metrics.height()
                columns = len(row.labels)
                if x + columns * cell > self.width():
                    x, y, columns = left, y + line, max(1, room // cell)
                for i, (label, value) in enumerate(zip(row.labels, row.values)):
                    at = QRect(x + i % columns * cell, y + i // columns * line, cell - 2 * GAP_PX, line)
                    if painter is not None:
                        self._draw_item(painter, at, row, label, value, extra)
                y += line * (-(-len(row.labels) // columns) - 1)
            y += lines * line
        return y

    def _draw_item(self, painter: QPainter, at: QRect, row: Row, label: str, value: float, width: int) -> None:
        stale = row.tone is RowTone.STALE
        mark = QRect(at.left(), at.top(), width, at.height())
        if row.kind == TICKS:
            painter.setPen(QColor(COLOURS[RowTone.STALE if stale else RowTone.GOOD if value else RowTone.FAULT]))
            painter.drawText(mark, Qt.AlignVCenter, "✓" if value else "✗")
        else:
            bar = QRect(mark.left(), mark.top() + GAP_PX, mark.width(), mark.height() - 2 * GAP_PX)
            colour = COLOURS[row.tone if row.tone is not RowTone.NORMAL else RowTone.GOOD]
            painter.fillRect(bar, BACKGROUND)
            painter.fillRect(QRect(bar.left(), bar.top(), round(value * bar.width()), bar.height()), QColor(colour))
        painter.setPen(QColor(COLOURS[RowTone.STALE if stale else RowTone.NORMAL]))
        painter.drawText(at.adjusted(width + GAP_PX, 0, 0, 0), Qt.AlignVCenter, label)


def _spoken(row: Row) -> str:
    items = []
    for label, value in zip(row.labels, row.values):
        items.append(f"{label} {('yes' if value else 'no') if row.kind == TICKS else f'{100 * value:.0f} %'}")
    return f"{row.name}: {row.text}. {', '.join(items)}".strip()
