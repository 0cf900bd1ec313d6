"""The control panel as a Qt widget: KUKA on the left, gripper and application on the right, a status line below.

It holds no state of its own: `show_state` sets what is seen, and the signals say what the person asked for.
"""

from __future__ import annotations

from python_qt_binding.QtCore import Qt, Signal
from python_qt_binding.QtWidgets import (
    QGridLayout,
    QGroupBox,
    QLabel,
    QPushButton,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from kuka_control.gui.panel_state import SCALING_DEFAULT, SCALING_MAX, SCALING_MIN, PanelState

STEPS_PER_UNIT = 10
"""The slider moves in tenths."""

TOGGLE_STYLE = "QPushButton:checked { background-color: #2e9e44; color: white; }"
STOP_STYLE = "QPushButton { background-color: #c62828; color: white; font-weight: bold; }"


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
        self.control = _toggle("control")
        self.gripper = _toggle("gripper")
        self.scaling_label = QLabel()
        self.scaling = QSlider(Qt.Horizontal)
        self.scaling.setObjectName("scaling")
        self.scaling.setRange(round(SCALING_MIN * STEPS_PER_UNIT), round(SCALING_MAX * STEPS_PER_UNIT))
        self.scaling.setPageStep(1)
        self.scaling.setTickPosition(QSlider.TicksBelow)
        self.reset = QPushButton("Reset Scaling Factor")
        self.exit = QPushButton("Exit Application")
        self.emergency = QPushButton("Emergency Stop")
        self.emergency.setStyleSheet(STOP_STYLE)
        self.emergency.setMinimumHeight(60)
        self.status = QLabel()
        self.status.setWordWrap(True)
        self.status.setMinimumHeight(40)
        self.answer = QLabel()
        self.answer.setWordWrap(True)
        for widget in (self.control, self.gripper, self.reset, self.exit, self.emergency):
            widget.setSizePolicy(QSizePolicy.Expanding, QSizePolicy.Expanding)
        self._arrange()
        # clicked comes from the person only; show_state never triggers it.
        self.control.clicked.connect(self._ask_control)
        self.gripper.clicked.connect(self._ask_gripper)
        self.scaling.sliderReleased.connect(self._ask_scaling)
        self.scaling.valueChanged.connect(self._scaling_moved)
        self.reset.clicked.connect(lambda: self.scaling_requested.emit(SCALING_DEFAULT))
        self.exit.clicked.connect(lambda: self.exit_requested.emit())
        self.emergency.clicked.connect(lambda: self.emergency_requested.emit())

    def show_state(self, state: PanelState) -> None:
        """Shows the state; a slider that the person holds stays where it is."""
        self.control.setChecked(state.control_on)
        self.gripper.setChecked(state.gripper_on)
        for widget in (self.control, self.gripper, self.exit):
            widget.setEnabled(state.present)
        self.scaling.setEnabled(state.scaling_enabled)
        self.reset.setEnabled(state.scaling_enabled)
        self.scaling.setToolTip("" if state.scaling_enabled else "Switch ROS Control off to change the scaling factor.")
        if not self.scaling.isSliderDown():
            self.scaling.blockSignals(True)
            self.scaling.setValue(round(state.scaling_factor * STEPS_PER_UNIT))
            self.scaling.blockSignals(False)
            self.scaling_label.setText(f"Scaling Factor: {state.scaling_factor:.1f}")
        self.status.setText(state.status_line)

    def show_answer(self, text: str) -> None:
        """Shows the answer to the person's last request."""
        self.answer.setText(text)

    def _arrange(self) -> None:
        grid = QGridLayout(self)
        grid.addWidget(_group("KUKA", self.control, self.scaling_label, self.scaling, self.reset), 0, 0, 2, 1)
        grid.addWidget(_group("Gripper", self.gripper), 0, 1)
        grid.addWidget(_group("Application", self.exit, self.emergency), 1, 1)
        grid.addWidget(self.status, 2, 0, 1, 2)
        grid.addWidget(self.answer, 3, 0, 1, 2)
        grid.setColumnStretch(0, 1)
        grid.setColumnStretch(1, 1)

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


def _toggle(name: str) -> QPushButton:
    button = QPushButton("ROS Control")
    button.setObjectName(name)
    button.setCheckable(True)
    button.setStyleSheet(TOGGLE_STYLE)
    button.setMinimumHeight(50)
    return button


def _group(title: str, *widgets: QWidget) -> QGroupBox:
    group = QGroupBox(title)
    layout = QVBoxLayout(group)
    for widget in widgets:
        layout.addWidget(widget)
    return group
