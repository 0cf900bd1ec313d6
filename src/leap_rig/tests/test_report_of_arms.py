"""The summary of two arms: each with its own counts and faults, and what they share once."""

from __future__ import annotations

import json

import pytest
from test_report import good_run

from common.poses import translation
from common.reasons import ReasonCode
from leap_rig.report.recorder import Recorder
from leap_rig.report.report import summarise as of_one
from leap_rig.report.report_of_arms import as_text, summarise


def test_an_only_arm_has_the_summary_that_it_always_had():
    summary = summarise({"": good_run()}, 20.0, ["leapd ended with exit code 1"], ["no film"])
    assert summary == of_one(good_run(), 20.0, ["leapd ended with exit code 1"], ["no film"])
    assert "The arm followed" in as_text(summarise({"": good_run()}, 20.0))


def test_each_arm_has_its_own_part_and_what_is_shared_stands_once():
    summary = json.loads(json.dumps(summarise({"left": good_run(), "right": good_run()}, 20.0)))
    assert summary["faults"] == summary["warnings"] == [] and set(summary["arms"]) == {"left", "right"}
    for part in summary["arms"].values():
        assert part["servo_goals_sent"] == 1000 and len(part["streams"]) == 1 and part["hand_travel_rad"][0] == 1.0
        assert not {"objects", "real_time_factor", "duration_s"} & set(part)
    assert summary["duration_s"] == 10.0 and summary["frames_received"] == 101
    text = as_text(summary)
    assert text.count("tool tracking error") == 2 and text.count("frames received") == 1
    assert "All arms followed and all hands moved, no node died." in text


def test_faults_and_warnings_say_which_arm():
    left, idle = good_run(), Recorder()
    idle.start(10.0)
    idle.stream(True, "", 11.0)
    idle.stream(False, "why", 12.0, (ReasonCode.TRACKER_SILENT,))
    idle.loads.append((12.0, 0.99))
    summary = summarise({"left": left, "right": idle}, 20.0, ["leapd ended with exit code 1"])
    assert summary["faults"] == [
        "A node died: leapd ended with exit code 1.",
        "right: The arm never followed a hand.",
        "right: The robot hand never moved.",
    ]
    (warning,) = summary["warnings"]
    assert warning.startswith("right: The stream was lost at 2.0 s")
    assert "  FAULT: right: The arm never followed a hand." in as_text(summary)


def handed_over(*held):
    """Two recorders of a box that these hands hold one after the other, a second each."""
    recorders = {arm: good_run() for arm in ("left", "right")}
    for recorder in recorders.values():
        done = {"scenario": "hand_over", "step": "done", "failure": "", "thing": "box"}
        recorder.set_scenario({**done, "giver": "left", "taker": "right"})
        recorder.add_object("box", translation(0.56, 0.19, 0.0), 0.0, ["table"], 11.0)
        for number, hands in enumerate(held):
            touches = [f"{hand}/reflex/proximal_1" for hand in hands]
            recorder.add_object("box", translation(0.56, 0.0, 0.15), 0.15, touches, 12.0 + number)
        recorder.add_object("box", translation(0.56, -0.19, 0.0), 0.0, ["table"], 18.0)
    return recorders


def test_a_hand_over_says_who_held_the_box_and_where_it_lies():
    summary = json.loads(json.dumps(summarise(handed_over(["left"], ["left", "right"], ["right"], []), 20.0)))
    assert summary["faults"] == []
    box = summary["objects"]["box"]
    assert box["held_by"] == [
        {"from_s": 2.0, "hands": ["left"]},
        {"from_s": 3.0, "hands": ["left", "right"]},
        {"from_s": 4.0, "hands": ["right"]},
    ]
    assert box["at_m"] == [0.56, -0.19] and box["picked_and_placed"] and box["lifted_mm"] == 150.0
    text = as_text(summary)
    assert "held by left from 2.0 s, held by left and right from 3.0 s, held by right from 4.0 s" in text
    assert "put down at 8.0 s, at x 0.56, y -0.19 m, 380 mm from where it stood" in text
    assert text.count("handed over            box, from left to right") == 2


@pytest.mark.parametrize(
    ("held", "words"),
    [
        ([["left"]], "it was held by left."),
        ([["left"], ["right"]], "it was held by left, then right."),
        ([["right"], ["left", "right"], ["right"]], "it was held by right, then left and right, then right."),
        ([["left"], ["left", "right"], ["left"]], "it was held by left, then left and right, then left."),
        ([[]], "it was held by nobody."),
    ],
)
def test_what_is_no_hand_over_is_a_fault_of_both_arms(held, words):
    faults = summarise(handed_over(*held), 20.0)["faults"]
    assert faults == [f"{arm}: The box was not handed over from left to right: {words}" for arm in ("left", "right")]


def test_the_scenario_of_each_arm_is_judged_by_its_own_cup():
    recorders = {arm: good_run() for arm in ("left", "right")}
    for arm, recorder in recorders.items():
        recorder.set_scenario({"scenario": "two_cups", "step": "done", "failure": "", "thing": f"{arm}_cup"})
        for thing, heights in (("left_cup", (0.0, 0.2, 0.0)), ("right_cup", (0.0,))):
            for number, height in enumerate(heights):
                touches = ["left/reflex/proximal_1"] if height else ["table"]
                recorder.add_object(thing, translation(0.0, 0.0, height), height, touches, 11.0 + number)
    summary = summarise(recorders, 20.0)
    assert summary["faults"] == ["right: The scenario two_cups picked up and put down nothing."]
    assert summary["objects"]["left_cup"]["picked_and_placed"]
    assert as_text(summary).count("scenario               two_cups: done") == 2
