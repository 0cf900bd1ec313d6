"""The control panel as a Qt widget: KUKA on the left, gripper and application on the right, two sentences below, and
under them what the operator needs to see. It holds no state: `show_state` sets what the widgets show, and signals
carry the operator's requests."""

from __future__ import annotations

import html
from collections.abc import Sequence

from python_qt_binding.QtCore import Qt, Signal
from python_qt_binding.QtGui import QKeySequence
from python_qt_binding.QtWidgets import (
    QGridLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPushButton,
    QScrollArea,
    QShortcut,
    QSizePolicy,
    QSlider,
    QVBoxLayout,
    QWidget,
)

from common.episode_marks import AGAIN, MARKS
from common.operator_rows import ARM, SILENT, Row
from kuka_control.gui.panel_rows import OperatorRows
from kuka_control.gui.panel_state import PanelState, Tone, factor_text
from kuka_control.numbers import SCALING_DEFAULT, SCALING_MAX, SCALING_MIN

GREEN = "#2e9e44"
RED = "#c62828"

STYLE = f"""
ControlPanel {{ background-color: #f4f6f8; }}
ControlPanel QLabel {{ color: #1f2933; font-size: 11pt; }}
ControlPanel QGroupBox {{
  color: #52606d; font-size: 10pt; font-weight: bold;
  background-color: #ffffff; border: 1px solid #cbd2d9; border-radius: 8px; margin-top: 22px; padding: 6px;
}}
ControlPanel QGroupBox::title {{ subcontrol-origin: margin; left: 4px; top: 2px; }}
ControlPanel QPushButton {{
  color: #1f2933; background-color: #e4e7eb; font-size: 11pt; font-weight: normal;
  border: 2px solid #cbd2d9; border-radius: 6px; padding: 4px 10px;
}}
ControlPanel QPushButton:hover {{ background-color: #d8dde3; }}
ControlPanel QPushButton:pressed {{ background-color: #cbd2d9; }}
ControlPanel QPushButton:focus {{ border-color: #2563eb; }}
ControlPanel QPushButton:disabled {{ color: #9aa5b1; background-color: #f1f3f5; border-color: #e4e7eb; }}
ControlPanel QPushButton[checkable="true"] {{ font-size: 13pt; }}
ControlPanel QPushButton:checked {{
  color: white; background-color: {GREEN}; border-color: #23803a; font-weight: bold;
}}
ControlPanel QPushButton:checked:focus {{ border-color: #14532d; }}
ControlPanel QPushButton#emergency {{
  color: white; background-color: {RED}; border: 3px solid #8e1b1b; font-size: 15pt; font-weight: bold;
}}
ControlPanel QPushButton#emergency:focus {{ border-color: #1f2933; }}
ControlPanel QPushButton#emergency:hover {{ background-color: #d63232; }}
ControlPanel QPushButton#emergency:pressed {{ background-color: #8e1b1b; }}
ControlPanel QSlider::groove:horizontal {{ height: 6px; border-radius: 3px; background-color: #cbd2d9; }}
ControlPanel QSlider::sub-page:horizontal {{ border-radius: 3px; background-color: #2563eb; }}
ControlPanel QSlider::handle:horizontal {{
  width: 22px; height: 22px; margin: -10px 0; border: 2px solid #2563eb; border-radius: 12px; background-color: #ffffff;
}}
ControlPanel QSlider::handle:horizontal:focus {{ background-color: #bfd4fb; }}
ControlPanel QSlider::sub-page:horizontal:disabled {{ background-color: #b4bec8; }}
ControlPanel QSlider::handle:horizontal:disabled {{ border-color: #b4bec8; background-color: #f1f3f5; }}
ControlPanel QLabel:disabled {{ color: #9aa5b1; }}
ControlPanel QLabel#end {{ color: #7b8794; font-size: 9pt; }}
ControlPanel QScrollArea {{ background-color: #ffffff; border: none; }}
ControlPanel OperatorRows {{ background-color: #ffffff; font-size: 10pt; }}
ControlPanel QLabel[tone] {{
  padding: 6px 10px; background-color: #ffffff; border: 1px solid #cbd2d9; border-radius: 6px;
}}
ControlPanel QLabel[tone="silent"] {{ background-color: transparent; border-color: transparent; }}
ControlPanel QLabel[tone="warning"] {{ background-color: #fff3d6; border-color: #e0b64a; }}
ControlPanel QLabel[tone="fault"] {{ background-color: #fde3e3; border-color: #d98282; }}
"""


STEPS_PER_UNIT = 100  # the slider moves in hundredths
EXIT_TIP = "The arm goes to the zero position, then the controller exits."


class Sentence(QLabel):
    """A sentence in a frame with room for `lines` lines; a longer one is cut, and whole in `full` and the tool tip.
    What a controller says is shown as it is, and never changes the panel's size."""

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
        shown = tone.value if text else "silent"
        if self.property("tone") != shown:
            self.setProperty("tone", shown)
            self.style().unpolish(self)  # Qt looks at properties only then
            self.style().polish(self)
        if text != self.full:
            self.full = text
            self._fit()

    def resizeEvent(self, event) -> None:
        super().resizeEvent(event)
        self._fit()

    def changeEvent(self, event) -> None:
        frame_px = 18  # height of frame and padding above and below the text
        super().changeEvent(event)
        self.setFixedHeight(self._height_of("\n" * (self._lines - 1)) + frame_px)

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
        unbounded_px = 10_000
        width = self.contentsRect().width()
        flags = int(Qt.TextWordWrap | Qt.AlignTop | Qt.AlignLeft)
        needed = self.fontMetrics().boundingRect(0, 0, width, unbounded_px, flags, text)
        return needed.height() if needed.width() <= width else unbounded_px


def label(text: str = "", name: str = "") -> QLabel:
    widget = QLabel(text)
    widget.setObjectName(name)
    widget.setTextFormat(Qt.PlainText)
    return widget


EMERGENCY_TIP = (
    "Stops the controller at once, by force if it hangs. {}\n"
    "Keys, while this window has the keyboard: Esc always, the space bar unless Tab has moved the focus.\n"
    "This is no safety function: keep the red button of the smartPad within reach."
)
RUNS_ON = (
    "The arm holds its last goal;\n"
    "a motion to a point (home, pick-up, zero) runs to its end: only the red button of the smartPad stops that."
)
STOPS = "The robot stops whatever moves,\nalso where the controller hangs: then once it misses that (watchdog_brake)."
PAUSE_TIP = "Pauses a motion to a point (home, pick-up, zero), and continues it. Control off ends it."

GUIDE_TIP = (
    "Lets a hand move the arm while the enabling switch is held: control on, at home or where a program left it."
)

POLICY_TIP = "Lets a program steer the tool while no hand does; a hand that comes in takes over."


def emergency_tip(stops: bool) -> str:
    """Returns what the Emergency Stop does; `stops`: the robot can stop a motion to a point."""
    return EMERGENCY_TIP.format(STOPS if stops else RUNS_ON)


class ControlPanel(QWidget):
    """The panel of one arm; `narrow`: in one column, beside that of another."""

    control_requested = Signal(bool)
    pause_requested = Signal(bool)
    guide_requested = Signal(bool)
    gripper_requested = Signal(bool)
    policy_requested = Signal(bool)
    mark_requested = Signal(str)
    scaling_requested = Signal(float)
    exit_requested = Signal()
    emergency_requested = Signal()

    def __init__(self, parent: QWidget | None = None, narrow: bool = False) -> None:
        super().__init__(parent)
        self.setWindowTitle("Leap Rig: control")
        self.setObjectName("LeapRigControlPanel")
        self.setAttribute(Qt.WA_StyledBackground)
        self.setStyleSheet(STYLE)
        high, lines = (44, 4) if narrow else (64, 3)
        self.control = _button("ROS Control", high, grows=True, checkable=True)
        self.control.setAccessibleName("ROS Control of the arm")
        self.pause = _button("Pause", 40, checkable=True)
        self.pause.setToolTip(PAUSE_TIP)
        self.guide = _button("Hand Guiding", 40, checkable=True)
        self.guide.setToolTip(GUIDE_TIP)
        for button in (self.pause, self.guide):
            button.hide()
        self.gripper = _button("ROS Control", high, grows=True, checkable=True)
        self.gripper.setAccessibleName("ROS Control of the gripper")
        self._toggles = (self.control, self.pause, self.guide, self.gripper)
        self.policy = _button("Run Policy", 32)
        self.policy.setToolTip(POLICY_TIP)
        self.no_policy = _button("Stop Policy", 32)
        self.marks = {mark: _button(mark.capitalize(), 32) for mark in MARKS}
        self.marks[AGAIN].setToolTip("Discards the episode, and begins another one.")
        self.scaling_label = label()
        self.scaling_label.setAlignment(Qt.AlignHCenter)
        self._held_at = 0  # where the slider was when the operator took it [steps]
        self.scaling = QSlider(Qt.Horizontal)
        self.scaling.setRange(round(SCALING_MIN * STEPS_PER_UNIT), round(SCALING_MAX * STEPS_PER_UNIT))
        self.scaling.setPageStep(STEPS_PER_UNIT // 10)
        self.scaling.setFocusPolicy(Qt.TabFocus)
        self.scaling.setMinimumHeight(32)
        self.reset = _button("Reset Scaling Factor", 40)
        self.exit = _button("Exit Application", 40)
        self.exit.setToolTip(EXIT_TIP)
        self.emergency = _button("Emergency Stop", 80, grows=True)
        self.emergency.setObjectName("emergency")
        self.emergency.setToolTip(emergency_tip(False))
        self.status = Sentence(lines)
        self.answer = Sentence(lines)
        self.operator = OperatorRows()
        self._arrange(narrow)
        self._connect()
        self.emergency.setFocus()

    def show_state(self, state: PanelState) -> None:
        """Shows the state; a slider that the operator holds stays where it is."""
        self.control.setChecked(state.control_on)
        self.gripper.setChecked(state.gripper_on)
        self.pause.setChecked(state.paused)
        self.pause.setVisible(state.stops)
        self.guide.setChecked(state.guided)
        self.guide.setVisible(state.guides)
        self.emergency.setToolTip(emergency_tip(state.stops))
        for button in (self.policy, self.no_policy):
            button.setVisible(state.policy)
        for button in self.marks.values():
            button.setVisible(state.episodes)
        self.training.setVisible(state.policy or state.episodes)
        for widget in (*self._toggles, self.exit, self.scaling, self.reset, self.scaling_label):
            widget.setEnabled(state.present)
        if not self.scaling.isSliderDown():
            self.scaling.blockSignals(True)
            self.scaling.setValue(round(state.scaling_factor * STEPS_PER_UNIT))
            self.scaling.blockSignals(False)
            self.scaling_label.setText(f"Scaling Factor: {factor_text(state.scaling_factor)}")
        self.status.show_text(state.status_line, state.tone)

    def show_answer(self, text: str, tone: Tone = Tone.NORMAL) -> None:
        self.answer.show_text(text, tone)

    def show_rows(self, rows: tuple[Row, ...] = SILENT) -> None:
        """Shows the rows of the operator's view; whatever they are, the rest of the panel stays where it is."""
        self.operator.show_rows(tuple(row for row in rows if row.name != ARM))  # which `status` says

    def _arrange(self, narrow: bool) -> None:
        operator_px = 40  # height of the operator's view in the smallest panel; it scrolls
        scale_ends = QHBoxLayout()
        scale_ends.addWidget(label(f"{SCALING_MIN:.1f}", "end"))
        scale_ends.addStretch(1)
        scale_ends.addWidget(label(f"{SCALING_MAX:.1f}", "end"))
        grid = QGridLayout(self)
        grid.setSpacing(4 if narrow else 10)
        if narrow:
            grid.setContentsMargins(0, 0, 0, 0)
        kuka = _group(
            "KUKA", self.control, self.pause, self.guide, self.scaling_label, self.scaling, scale_ends, self.reset
        )
        gripper, end = _group("Gripper", self.gripper), _group("Application", self.exit, self.emergency)
        columns = 1 if narrow else 2
        if narrow:
            for row, group in enumerate((kuka, gripper, end)):
                grid.addWidget(group, row, 0)
        else:
            grid.addWidget(kuka, 0, 0, 2, 1)
            grid.addWidget(gripper, 0, 1)
            grid.addWidget(end, 1, 1)
        steering, episodes = QHBoxLayout(), QHBoxLayout()
        for button in (self.policy, self.no_policy):
            steering.addWidget(button)
        for button in self.marks.values():
            episodes.addWidget(button)
        self.training = _group("Policy and Episodes", steering, episodes)
        self.training.hide()
        grid.addWidget(self.training, 3, 0, 1, columns)
        grid.addWidget(self.status, 4, 0, 1, columns)
        grid.addWidget(self.answer, 5, 0, 1, columns)
        view = QScrollArea()
        view.setWidgetResizable(True)
        view.setFocusPolicy(Qt.NoFocus)
        view.setMinimumHeight(operator_px)
        view.setWidget(self.operator)
        self.show_rows()
        self.operator_view = _group("Operator", view)
        grid.addWidget(self.operator_view, 6, 0, 1, columns)
        grid.setRowStretch(6, 1)
        for column in range(columns):
            grid.setColumnStretch(column, 1)
            grid.setColumnMinimumWidth(column, 230 if narrow else 240)
        order = (
            self.emergency,
            self.control,
            self.pause,
            self.guide,
            self.scaling,
            self.reset,
            self.gripper,
            self.exit,
            self.policy,
            self.no_policy,
            *self.marks.values(),
        )
        for first, second in zip(order, order[1:]):
            self.setTabOrder(first, second)

    def _connect(self) -> None:
        # clicked comes from the operator only; show_state never triggers it.
        self.control.clicked.connect(lambda on: self._ask(self.control, self.control_requested, on))
        self.pause.clicked.connect(lambda on: self._ask(self.pause, self.pause_requested, on))
        self.guide.clicked.connect(lambda on: self._ask(self.guide, self.guide_requested, on))
        self.gripper.clicked.connect(lambda on: self._ask(self.gripper, self.gripper_requested, on))
        self.policy.clicked.connect(lambda: self.policy_requested.emit(True))
        self.no_policy.clicked.connect(lambda: self.policy_requested.emit(False))
        for mark, button in self.marks.items():
            button.clicked.connect(lambda _, mark=mark: self.mark_requested.emit(mark))
        self.scaling.sliderPressed.connect(self._scaling_held)
        self.scaling.sliderReleased.connect(self._scaling_released)
        self.scaling.valueChanged.connect(self._scaling_moved)
        self.reset.clicked.connect(lambda: self.scaling_requested.emit(SCALING_DEFAULT))
        self.exit.clicked.connect(lambda: self.exit_requested.emit())
        # Acts when it is pressed, not when it is released.
        self.emergency.pressed.connect(lambda: self.emergency_requested.emit())
        # Not the whole window's: in rqt that holds other plugins too.
        shortcut = QShortcut(QKeySequence(Qt.Key_Escape), self, context=Qt.WidgetWithChildrenShortcut)
        shortcut.setAutoRepeat(False)
        shortcut.activated.connect(lambda: self.emergency_requested.emit())

    def _ask(self, button: QPushButton, request: Signal, on: bool) -> None:
        button.setChecked(not on)  # it turns green when the controller says that it is on
        request.emit(on)

    def _scaling_held(self) -> None:
        self._held_at = self.scaling.value()

    def _scaling_released(self) -> None:
        if self.scaling.value() != self._held_at:  # a factor between two steps is not rounded by a mere touch
            self._ask_scaling()

    def _scaling_moved(self, steps: int) -> None:
        self.scaling_label.setText(f"Scaling Factor: {factor_text(steps / STEPS_PER_UNIT)}")
        if not self.scaling.isSliderDown():  # keys, wheel and clicks beside the handle release nothing
            self._ask_scaling()

    def _ask_scaling(self) -> None:
        self.scaling_requested.emit(self.scaling.value() / STEPS_PER_UNIT)


ALL_ARMS_TIP = (
    emergency_tip(False)
    .replace("the controller", "the controllers of all arms")
    .replace("The arm", "Each arm")
    .replace("runs to its end:", "runs to its end, but where there is a button Pause:")
)


class ArmsPanel(QWidget):
    """The panels of several arms side by side, by their names in `panels`, over one Emergency Stop for all."""

    emergency_requested = Signal()

    def __init__(self, arms: Sequence[str]) -> None:
        super().__init__()
        self.setWindowTitle("Leap Rig: control of " + " and ".join(arms))
        self.setStyleSheet(STYLE.replace("ControlPanel", "ArmsPanel"))
        self.panels = {arm: ControlPanel(narrow=True) for arm in arms}
        self.emergency = _button("Emergency Stop of all arms", 80)
        self.emergency.setObjectName("emergency")
        self.emergency.setToolTip(ALL_ARMS_TIP)
        self.emergency.pressed.connect(lambda: self.emergency_requested.emit())
        grid = QGridLayout(self)
        for column, (arm, panel) in enumerate(self.panels.items()):
            group = _group(arm.upper(), panel)
            group.layout().setContentsMargins(0, 0, 0, 0)
            grid.addWidget(group, 0, column)
            panel.emergency.hide()
            panel.operator_view.hide()  # the node operator_view knows one arm
            # Its key Esc.
            panel.emergency_requested.connect(lambda: self.emergency_requested.emit())
        grid.addWidget(self.emergency, 1, 0, 1, len(self.panels))
        grid.setRowStretch(0, 1)
        # Not the whole window's: a second one would make the panels' own ambiguous.
        shortcut = QShortcut(QKeySequence(Qt.Key_Escape), self.emergency, context=Qt.WidgetShortcut)
        shortcut.setAutoRepeat(False)
        shortcut.activated.connect(lambda: self.emergency_requested.emit())
        self.emergency.setFocus()


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
