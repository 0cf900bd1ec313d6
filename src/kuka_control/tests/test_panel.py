"""The control panel as a Qt widget, clicked as a person does, without a screen."""

from __future__ import annotations

from dataclasses import replace

import pytest

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")


@pytest.fixture
def panel(application):
    from kuka_control.gui.panel import ControlPanel

    widget = ControlPanel()
    widget.show_state(state())
    widget.show()
    yield widget
    widget.close()


def state(**changes):
    from kuka_control.gui.panel_state import PanelState

    return replace(PanelState(True, False, False, 1.0, "home: waiting"), **changes)


def click(button):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    QTest.mouseClick(button, Qt.LeftButton)


def emitted(signal) -> list:
    values = []
    signal.connect(lambda *args: values.append(args))
    return values


@pytest.mark.parametrize("name", ["control", "gripper"])
def test_a_toggle_asks_and_turns_green_only_when_the_function_is_on(panel, name):
    button, asked = getattr(panel, name), emitted(getattr(panel, f"{name}_requested"))
    click(button)
    assert asked == [(True,)] and not button.isChecked()
    panel.show_state(state(**{f"{name}_on": True}))
    assert button.isChecked() and asked == [(True,)]
    click(button)
    assert asked == [(True,), (False,)] and button.isChecked()


def test_a_motion_is_paused_only_where_the_robot_can_and_the_tip_says_what_a_stop_does(panel):
    asked = emitted(panel.pause_requested)
    assert not panel.pause.isVisible() and "only the red button of the smartPad stops that" in panel.emergency.toolTip()
    panel.show_state(state(stops=True))
    assert panel.pause.isVisible() and "The robot stops whatever moves" in panel.emergency.toolTip()
    click(panel.pause)
    assert asked == [(True,)] and not panel.pause.isChecked()
    panel.show_state(state(stops=True, paused=True))
    assert panel.pause.isChecked()
    click(panel.pause)
    assert asked == [(True,), (False,)]
    panel.show_state(state(stops=True, present=False))
    assert not panel.pause.isEnabled() and "The robot stops whatever moves" in panel.emergency.toolTip()


def test_policy_and_episodes_have_buttons_only_where_their_services_are(panel):
    policy, marks = emitted(panel.policy_requested), emitted(panel.mark_requested)
    buttons = [panel.policy, panel.no_policy, *panel.marks.values()]
    assert not any(button.isVisible() for button in (*buttons, panel.training))
    panel.show_state(state(policy=True))
    assert [button.isVisible() for button in buttons] == [True] * 2 + [False] * 5
    panel.show_state(state(episodes=True, present=False))
    assert [button.isVisible() for button in buttons] == [False] * 2 + [True] * 5
    panel.show_state(state(policy=True, episodes=True))
    for button in buttons:
        click(button)
    assert policy == [(True,), (False,)]
    assert marks == [("begin",), ("success",), ("failure",), ("discard",), ("again",)]
    panel.show_state(state())
    assert not panel.training.isVisible()


@pytest.mark.parametrize(("key", "factor"), [("Key_Left", 0.99), ("Key_Right", 1.01), ("Key_PageDown", 0.9)])
def test_keys_move_the_slider_by_a_hundredth_or_a_tenth(panel, key, factor):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    asked = emitted(panel.scaling_requested)
    QTest.keyClick(panel.scaling, getattr(Qt, key))
    assert asked == [(factor,)] and panel.scaling_label.text() == f"Scaling Factor: {factor:.2f}"


@pytest.mark.parametrize("steps", [10, 37, 99, 101, 150])
def test_every_hundredth_can_be_dragged_to(panel, steps):
    asked = emitted(panel.scaling_requested)
    panel.scaling.setSliderDown(True)
    panel.scaling.setSliderPosition(steps)
    panel.scaling.setSliderDown(False)
    assert asked == [(steps / 100,)]


def test_a_factor_between_two_steps_is_shown_exactly_and_not_rounded_by_a_touch(panel):
    asked = emitted(panel.scaling_requested)
    panel.show_state(state(scaling_factor=0.3337))
    assert panel.scaling_label.text() == "Scaling Factor: 0.3337" and panel.scaling.value() == 33
    panel.scaling.setSliderDown(True)
    panel.scaling.setSliderDown(False)
    assert asked == [] and panel.scaling_label.text() == "Scaling Factor: 0.3337"


def test_dragging_asks_once_at_its_end(panel):
    asked = emitted(panel.scaling_requested)
    panel.scaling.setSliderDown(True)
    panel.scaling.setSliderPosition(50)
    panel.show_state(state(scaling_factor=1.0))
    assert asked == [] and panel.scaling_label.text() == "Scaling Factor: 0.50"
    panel.scaling.setSliderDown(False)
    assert asked == [(0.5,)]


def test_without_a_controller_only_the_emergency_stop_works(panel):
    panel.show_state(state(present=False, status_line="silent"))
    asked, stopped = emitted(panel.exit_requested), emitted(panel.emergency_requested)
    click(panel.exit)
    click(panel.emergency)
    assert asked == [] and len(stopped) == 1
    assert not panel.control.isEnabled() and panel.status.full == "silent"


def test_the_arrangement_is_that_of_the_original(panel):
    kuka, gripper, emergency = panel.control, panel.gripper, panel.emergency
    left = kuka.mapTo(panel, kuka.rect().center())
    right = gripper.mapTo(panel, gripper.rect().center())
    below = emergency.mapTo(panel, emergency.rect().center())
    assert left.x() < right.x() and right.y() < below.y() and below.x() > left.x()
    assert kuka.parentWidget().height() > gripper.parentWidget().height() + emergency.parentWidget().height()


def test_the_emergency_stop_acts_when_it_is_pressed(panel):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    stopped = emitted(panel.emergency_requested)
    QTest.mousePress(panel.emergency, Qt.LeftButton)
    assert len(stopped) == 1
    QTest.mouseRelease(panel.emergency, Qt.LeftButton)
    assert len(stopped) == 1


def test_clicks_leave_the_focus_on_the_emergency_stop(panel, application):
    from python_qt_binding.QtCore import Qt

    panel.activateWindow()
    application.processEvents()
    assert panel.focusWidget() is panel.emergency
    for button in (panel.control, panel.gripper, panel.reset, panel.exit):
        click(button)
        assert panel.focusWidget() is panel.emergency
    assert panel.scaling.focusPolicy() == Qt.TabFocus


def test_tab_goes_through_all_controls(panel, application):
    panel.activateWindow()
    application.processEvents()
    order = []
    for _ in range(6):
        order.append(panel.focusWidget())
        panel.focusNextChild()
    assert order == [panel.emergency, panel.control, panel.scaling, panel.reset, panel.gripper, panel.exit]
    assert panel.focusWidget() is panel.emergency


def test_escape_stops_wherever_the_focus_is(panel, application):
    from python_qt_binding.QtCore import Qt
    from python_qt_binding.QtTest import QTest

    panel.activateWindow()
    application.processEvents()
    stopped = emitted(panel.emergency_requested)
    for widget in (panel.emergency, panel.control, panel.scaling):
        widget.setFocus()
        QTest.keyClick(widget, Qt.Key_Escape)
    assert len(stopped) == 3
    assert "Esc" in panel.emergency.toolTip() and "smartPad" in panel.emergency.toolTip()


def test_a_text_of_any_length_leaves_the_panel_as_it_is(panel, application):
    size, smallest = panel.size(), panel.minimumSizeHint()
    for text in ("a word " * 200, "x" * 5000, "line\n" * 50, "<b>no</b> & <img src=x>"):
        panel.show_state(state(status_line=text))
        panel.show_answer(text)
        application.processEvents()
        assert panel.size() == size and panel.minimumSizeHint() == smallest
        for sentence in (panel.status, panel.answer):
            assert sentence.full == text
            assert text.startswith(sentence.text().rstrip("…").rstrip())
            assert (sentence.text() == text) == (sentence.toolTip() == "")
    assert panel.status.text() == "<b>no</b> & <img src=x>"


def test_the_sentences_of_an_emergency_are_never_cut(panel, application):
    from kuka_control.gui.panel_state import Tone

    panel.resize(panel.minimumSizeHint())
    longest = (
        "23:59:59  Emergency Stop: the controller on a-long-name-of-a-computer did not confirm it. "
        "Press the red button of the smartPad."
    )
    panel.show_answer(longest, Tone.WARNING)
    application.processEvents()
    assert panel.answer.text() == longest


@pytest.mark.parametrize("checked, colour", [(True, "#2e9e44"), (False, "#e4e7eb")])
def test_green_is_on_and_red_stops(panel, application, checked, colour):
    panel.show_state(state(control_on=checked))
    application.processEvents()
    picture = panel.grab().toImage()

    def colour_of(widget):
        return picture.pixelColor(widget.mapTo(panel, widget.rect().topLeft()).x() + 10, middle(widget)).name()

    def middle(widget):
        return widget.mapTo(panel, widget.rect().center()).y()

    assert colour_of(panel.control) == colour
    assert colour_of(panel.emergency) == "#c62828"


def rows(*texts):
    from common.operator_rows import BARS, TICKS, Row, RowTone

    kinds = ((TICKS, ("in the box", "flat"), (1.0, 0.0)), (BARS, ("index", "thumb"), (0.0, 1.0)))
    return tuple(Row(f"Row {i}", text, RowTone.WARNING, *kinds[i % 2]) for i, text in enumerate(texts))


def test_what_the_operator_sees_moves_nothing_else(panel, application):
    sizes = panel.minimumSizeHint(), panel.emergency.geometry(), panel.answer.geometry()
    assert "operator_view" in panel.operator.accessibleDescription()
    for texts in (("short", "<b>x</b>"), ("word " * 100,) * 20, ()):
        panel.show_rows(rows(*texts))
        application.processEvents()
        assert (panel.minimumSizeHint(), panel.emergency.geometry(), panel.answer.geometry()) == sizes
    panel.show_rows(rows("short", "<b>x</b>"))
    assert "in the box yes, flat no" in panel.operator.accessibleDescription()
    assert "thumb 100 %" in panel.operator.accessibleDescription() and "&lt;b&gt;" in panel.operator.toolTip()


def test_the_smallest_panel_has_room_for_all_controls_and_part_of_the_view(panel, application):
    panel.show_rows(rows(*"abcdefgh"))
    panel.resize(panel.minimumSizeHint())
    application.processEvents()
    assert panel.height() <= 600
    for widget in (panel.control, panel.gripper, panel.exit, panel.emergency, panel.operator):
        assert not widget.visibleRegion().isEmpty()


@pytest.mark.parametrize("screen", [(1600, 1000), (1280, 800)])
def test_the_panel_of_two_arms_leaves_room_for_rviz(application, screen):
    from common.screen import panel_area
    from kuka_control.gui.panel import ArmsPanel

    window = ArmsPanel(("left", "right"))
    least, (*_, width, height) = window.minimumSizeHint(), panel_area(0, 0, *screen)
    assert least.width() <= width and least.height() <= height


def test_a_reason_too_long_for_a_line_gets_a_second_one(panel):
    from common.operator_rows import Row, RowTone

    heights = []
    for words in (5, 20, 200):
        panel.show_rows((Row("Hand", "word " * words, RowTone.NORMAL),))
        heights.append(panel.operator.height())
    assert heights[1:] == [2 * heights[0]] * 2


def test_ticks_are_green_or_red_and_bars_as_long_as_their_values(panel, application):
    from common.operator_rows import COLOURS, RowTone

    panel.resize(560, 800)
    panel.show_rows(rows("a", "b"))
    application.processEvents()
    picture = panel.operator.grab().toImage()
    found = {picture.pixelColor(x, y).name() for x in range(picture.width()) for y in range(picture.height())}
    assert {COLOURS[RowTone.GOOD], COLOURS[RowTone.FAULT], COLOURS[RowTone.WARNING]} <= found
