"""The window of the tutorial: the steps with their ticks, what to do now, how far it is done, and a hint."""

from __future__ import annotations

from python_qt_binding.QtCore import Qt
from python_qt_binding.QtWidgets import QLabel, QProgressBar, QVBoxLayout, QWidget

from leap_rig.operator.tutorial import STEPS, TutorialView

STYLE = """
TutorialWindow { background-color: #f4f6f8; }
QLabel { color: #1f2933; font-size: 12pt; }
QLabel[state="ticked"] { color: #2e9e44; font-weight: bold; }
QLabel[state="present"] { font-weight: bold; }
QLabel[state="later"] { color: #7b8794; }
QLabel#instruction { font-size: 17pt; font-weight: bold; }
QLabel#hint { background-color: #fff3d6; border: 1px solid #e0b64a; border-radius: 6px; padding: 8px; }
QLabel#hint[empty="true"] { background-color: transparent; border-color: transparent; }
QProgressBar { border: 1px solid #cbd2d9; border-radius: 6px; background-color: #ffffff; height: 14px; }
QProgressBar::chunk { border-radius: 5px; background-color: #2e9e44; }
"""
MARKS = {"ticked": "✔", "present": "▶", "later": "○"}
SIZE_PX = (460, 490)


class TutorialWindow(QWidget):
    """Shows views in the language of `texts`."""

    def __init__(self, texts: dict[str, str]) -> None:
        super().__init__()
        self._texts = texts
        self.setWindowTitle(texts["title"])
        self.setWindowFlag(Qt.WindowStaysOnTopHint)  # beside the control panel, above RViz
        self.setAttribute(Qt.WA_StyledBackground)
        self.setStyleSheet(STYLE)
        self.steps = {name: QLabel() for name in STEPS}
        self.instruction, self.hint, self.progress = QLabel(objectName="instruction"), QLabel(), QProgressBar()
        self.hint.setObjectName("hint")
        self.progress.setTextVisible(False)
        self.progress.setRange(0, 100)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(18, 14, 18, 14)
        for widget in self.steps.values():
            layout.addWidget(widget)
        for widget in (self.instruction, self.hint):
            widget.setWordWrap(True)
            widget.setAlignment(Qt.AlignTop | Qt.AlignLeft)
        layout.addSpacing(8)
        layout.addWidget(self.instruction, 1)
        layout.addWidget(self.progress)
        layout.addWidget(self.hint)
        self.resize(*SIZE_PX)

    def showEvent(self, event) -> None:
        """Reserves two lines for the hint, so that nothing jumps."""
        hint_frame_px = 20
        super().showEvent(event)
        self.hint.setMinimumHeight(2 * self.hint.fontMetrics().lineSpacing() + hint_frame_px)

    def show_view(self, view: TutorialView) -> None:
        for name, widget in self.steps.items():
            widget.setVisible(name in view.steps)
            if name in view.steps:
                place = view.steps.index(name)
                state = "ticked" if place < view.ticked else "present" if place == view.ticked else "later"
                widget.setText(f"{MARKS[state]}  {self._texts[f'name_{name}']}")
                _set(widget, "state", state)
        self.instruction.setText(self._texts[f"do_{view.step}"])
        self.progress.setValue(round(100 * view.progress))
        self.hint.setText(self._texts[f"hint_{view.hint}"] if view.hint else "")
        _set(self.hint, "empty", not view.hint)


def _set(widget: QWidget, name: str, value: object) -> None:
    if widget.property(name) != value:
        widget.setProperty(name, value)
        widget.style().unpolish(widget)  # Qt looks at properties only then
        widget.style().polish(widget)
