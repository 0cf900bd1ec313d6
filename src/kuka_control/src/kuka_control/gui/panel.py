"""The control panel as a Qt widget: KUKA on the left, gripper and application on the right, two sentences below.

It holds no state: `show_state` sets what the widgets show, and signals carry the operator's requests.
"""

from __future__ import annotations

from python_qt_binding.QtCore import Qt, Signal
from python_qt_binding.QtGui import QKeySequence
from python_qt_binding.QtWidgets import (
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QPushButton,
    QShortcut,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from kuka_control.gui.panel_state import PanelState, Tone
from kuka_control.gui.sentence import Sentence, label
from kuka_control.gui.style import STYLE
from kuka_control.model.scaling import SCALING_DEFAULT, SCALING_MAX, SCALING_MIN

STEPS_PER_UNIT = 10
"""The slider moves in tenths."""

EMERGENCY_TIP = (
    "Stops the controller at once, by force if it hangs. The arm holds its last goal;\n"
    "a motion to a point (home, pick-up, zero) runs to its end: only the red button of the smartPad stops that.\n"
    "Keys, while this window has the keyboard: Esc always, the space bar unless Tab has moved the focus.\n"
    "This is no safety function: keep that button within reach."
)
EXIT_TIP = "The arm goes to the zero position, then the controller exits."
LOCKED_TIP = "Switch ROS Control off to change the scaling factor."


class ControlPanel(QWidget):
    """The panel of the arm and the gripper."""

    control_requested = Signal(bool)
    gripper_requested = Signal(bool)
    scaling_requested = Signal(float)
    exit_requested = Signal()
    emergency_requested = Signal()

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setWindowTitle("Leap Rig: control")
        self.setObjectName("LeapRigControlPanel")
        self.setAttribute(Qt.WA_StyledBackground)
        self.setStyleSheet(STYLE)
        self.control = _button("ROS Control", 64, grows=True, checkable=True)
        self.control.setAccessibleName("ROS Control of the arm")
        self.gripper = _button("ROS Control", 64, grows=True, checkable=True)
        self.gripper.setAccessibleName("ROS Control of the gripper")
        self.scaling_label = label()
        self.scaling_label.setAlignment(Qt.AlignHCenter)
        self.scaling = QSlider(Qt.Horizontal)
        self.scaling.setRange(round(SCALING_MIN * STEPS_PER_UNIT), round(SCALING_MAX * STEPS_PER_UNIT))
        self.scaling.setPageStep(1)
        self.scaling.setFocusPolicy(Qt.TabFocus)
        self.scaling.setMinimumHeight(32)
        self.reset = _button("Reset Scaling Factor", 40)
        self.exit = _button("Exit Application", 40)
        self.exit.setToolTip(EXIT_TIP)
        self.emergency = _button("Emergency Stop", 80, grows=True)
        self.emergency.setObjectName("emergency")
        self.emergency.setToolTip(EMERGENCY_TIP)
        self.status = Sentence(lines=3)
        self.answer = Sentence(lines=3)
        self._arrange()
        self._connect()
        self.emergency.setFocus()

    def show_state(self, state: PanelState) -> None:
        """Shows the state; a slider that the operator holds stays where it is."""
        self.control.setChecked(state.control_on)
        self.gripper.setChecked(state.gripper_on)
        for widget in (self.control, self.gripper, self.exit):
            widget.setEnabled(state.present)
        for widget in (self.scaling, self.reset, self.scaling_label):
            widget.setEnabled(state.scaling_enabled)
            widget.setToolTip(LOCKED_TIP if state.present and not state.scaling_enabled else "")
        if not self.scaling.isSliderDown():
            self.scaling.blockSignals(True)
            self.scaling.setValue(round(state.scaling_factor * STEPS_PER_UNIT))
            self.scaling.blockSignals(False)
            self.scaling_label.setText(f"Scaling Factor: {state.scaling_factor:.1f}")
        self.status.show_text(state.status_line, state.tone)

    def show_answer(self, text: str, tone: Tone = Tone.NORMAL) -> None:
        """Shows the answer to the operator's last request."""
        self.answer.show_text(text, tone)

    def _arrange(self) -> None:
        scale_ends = QHBoxLayout()
        scale_ends.addWidget(label(f"{SCALING_MIN:.1f}", "end"))
        scale_ends.addStretch()
        scale_ends.addWidget(label(f"{SCALING_MAX:.1f}", "end"))
        grid = QGridLayout(self)
        grid.setSpacing(10)
        kuka = _group("KUKA", self.control, self.scaling_label, self.scaling, scale_ends, self.reset)
        grid.addWidget(kuka, 0, 0, 2, 1)
        grid.addWidget(_group("Gripper", self.gripper), 0, 1)
        grid.addWidget(_group("Application", self.exit, self.emergency), 1, 1)
        grid.addWidget(self.status, 2, 0, 1, 2)
        grid.addWidget(self.answer, 3, 0, 1, 2)
        for column in (0, 1):
            grid.setColumnStretch(column, 1)
            grid.setColumnMinimumWidth(column, 240)
        order = (self.emergency, self.control, self.scaling, self.reset, self.gripper, self.exit)
        for first, second in zip(order, order[1:]):
            self.setTabOrder(first, second)

    def _connect(self) -> None:
        # clicked comes from the operator only; show_state never triggers it.
        self.control.clicked.connect(self._ask_control)
        self.gripper.clicked.connect(self._ask_gripper)
        self.scaling.sliderReleased.connect(self._ask_scaling)
        self.scaling.valueChanged.connect(self._scaling_moved)
        self.reset.clicked.connect(lambda: self.scaling_requested.emit(SCALING_DEFAULT))
        self.exit.clicked.connect(lambda: self.exit_requested.emit())
        # Acts when it is pressed, not when it is released.
        self.emergency.pressed.connect(lambda: self.emergency_requested.emit())
        # Not the whole window's: in rqt that holds other plugins too.
        shortcut = QShortcut(QKeySequence(Qt.Key_Escape), self, context=Qt.WidgetWithChildrenShortcut)
        shortcut.setAutoRepeat(False)
        shortcut.activated.connect(lambda: self.emergency_requested.emit())

    def _ask_control(self, on: bool) -> None:
        self.control.setChecked(not on)  # it turns green when the controller says that it is on
        self.control_requested.emit(on)

    def _ask_gripper(self, on: bool) -> None:
        self.gripper.setChecked(not on)
        self.gripper_requested.emit(on)

    def _scaling_moved(self, steps: int) -> None:
        self.scaling_label.setText(f"Scaling Factor: {steps / STEPS_PER_UNIT:.1f}")
        if not self.scaling.isSliderDown():  # keys, wheel and clicks beside the handle release nothing
            self._ask_scaling()

    def _ask_scaling(self) -> None:
        self.scaling_requested.emit(self.scaling.value() / STEPS_PER_UNIT)


def _button(text: str, height: int, grows: bool = False, checkable: bool = False) -> QPushButton:
    button = QPushButton(text)
    button.setCheckable(checkable)
    button.setMinimumHeight(height)
    button.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Expanding if grows else QSizePolicy.Fixed)
    # A click leaves the focus where it is, on Emergency Stop, so that the space bar stops and never switches on.
    button.setFocusPolicy(Qt.TabFocus)
    return button


def _group(title: str, *contents: QWidget | QHBoxLayout) -> QGroupBox:
    group = QGroupBox(title)
    layout = QVBoxLayout(group)
    layout.setSpacing(8)
    for content in contents:
        if isinstance(content, QWidget):
            layout.addWidget(content)
        else:
            layout.addLayout(content)
    return group
