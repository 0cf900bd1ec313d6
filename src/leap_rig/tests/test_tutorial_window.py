"""The window of the tutorial, without a screen: what it shows, and that every text fits."""

from __future__ import annotations

import pytest

from leap_rig.operator.tutorial import DONE, STEPS, TutorialView
from leap_rig.operator.tutorial_texts import TEXTS

pytest.importorskip("python_qt_binding", reason="python3-python-qt-binding is not installed")


@pytest.fixture(params=TEXTS)
def window(application, request):
    from leap_rig.operator.tutorial_window import TutorialWindow

    widget = TutorialWindow(TEXTS[request.param])
    widget.show()
    yield widget
    widget.close()


def test_done_present_and_later_steps_differ_and_an_absent_one_is_hidden(window):
    steps = tuple(step for step in STEPS if step != "clutch")
    window.show_view(TutorialView(steps, 2, "move", 0.4, "slower"))
    states = [window.steps[step].property("state") for step in steps]
    assert states == ["ticked", "ticked", "present", "later", "later", "later"]
    assert window.steps["clutch"].isHidden() and window.progress.value() == 40
    texts = window._texts
    assert (window.instruction.text(), window.hint.text()) == (texts["do_move"], texts["hint_slower"])
    window.show_view(TutorialView(steps, 6, DONE, 1.0, ""))
    assert {window.steps[step].property("state") for step in steps} == {"ticked"}
    assert window.instruction.text() == texts["do_done"] and window.hint.text() == ""


def test_every_text_fits_into_the_window(window):
    from leap_rig.operator.tutorial_window import SIZE_PX

    hints = sorted(key[len("hint_") :] for key in window._texts if key.startswith("hint_"))
    for i, hint in enumerate(hints):
        step = (*STEPS, DONE)[i % (len(STEPS) + 1)]
        window.show_view(TutorialView(STEPS, i % len(STEPS), step, 0.5, hint))
        window.layout().activate()
        assert window.layout().totalHeightForWidth(SIZE_PX[0]) <= SIZE_PX[1], (step, hint)
        assert window.layout().totalMinimumSize().width() <= SIZE_PX[0]
