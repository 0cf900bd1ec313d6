"""What the report says of the grasps of the scenario assisted_grasp."""

from __future__ import annotations

import pytest

from common.poses import translation
from leap_rig.report.recorder import Recorder
from leap_rig.report.report import as_text, summarise

HELD = {
    "scenario": "assisted_grasp",
    "step": "done",
    "failure": "",
    "round": "1",
    "object": "box",
    "proposals": "3",
    "executed": "2",
    "refused": "Control of the arm is off.",
    "failed": "the arm followed the hand no more",
    "correction_m": "0.01240",
    "correction_rad": "-0.10472",
    "lifted_m": "0.21500",
    "held": "true",
    "outcome": "The thumb and a finger felt something.",
}
LOOKING = {**HELD, "step": "look", "object": "", "correction_m": "", "correction_rad": "", "held": "", "outcome": ""}


def summary_of(*reported, put_down=True):
    recorder = Recorder()
    recorder.start(0.0)
    for values in reported:
        recorder.set_scenario(values)
    recorder.add_object("box", translation(0.0, 0.0, 0.1), 0.0, ("table",), 1.0)
    recorder.add_object("box", translation(0.0, 0.0, 0.3), 0.2, ("reflex/distal_1",), 2.0)
    if put_down:
        recorder.add_object("box", translation(0.0, 0.0, 0.1), 0.0, ("table",), 3.0)
    return summarise(recorder, 10.0)


def test_a_grasp_is_reported_in_numbers_and_in_words():
    summary = summary_of(LOOKING, HELD)
    assert summary["scenario"] == {"scenario": "assisted_grasp", "step": "done", "failure": ""}
    (grasp,) = summary["grasps"]
    assert (grasp["correction_mm"], grasp["correction_deg"], grasp["lifted_mm"]) == (12.4, -6.0, 215.0)
    assert (grasp["proposals_seen"], grasp["executed"], grasp["held"]) == (3, 2, True)
    text = as_text(summary)
    for line in (
        "1: box; proposals seen: 3, executed: 2",
        "refused: Control of the arm is off.",
        "failed: the arm followed the hand no more",
        "corrected by hand by 12 mm and -6 deg, lifted 215 mm",
        "held: The thumb and a finger felt something.",
    ):
        assert line in text
    assert not any("grasp" in fault for fault in summary["faults"])


def test_a_grasp_that_was_not_put_down_is_a_fault():
    faults = summary_of(HELD, put_down=False)["faults"]
    assert "The box of grasp 1 does not stand on the table again." in faults


@pytest.mark.parametrize("second", [{**HELD, "round": "2"}, {**LOOKING, "round": "2"}])
def test_each_round_is_reported(second):
    assert [grasp["round"] for grasp in summary_of(HELD, second)["grasps"]] == [1, 2]


def test_a_scenario_that_was_given_up_says_why():
    reported = {**LOOKING, "failure": "waited 60 s in vain: no grasp is proposed"}
    summary = summary_of(reported)
    assert summary["grasps"][0]["held"] is None and summary["grasps"][0]["correction_mm"] is None
    assert any("was not finished: waited 60 s in vain" in fault for fault in summary["faults"])
    assert "held:" not in as_text(summary)
