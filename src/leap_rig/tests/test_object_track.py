"""What the report says of an object of the simulated world."""

from __future__ import annotations

import numpy as np
import pytest

from common.poses import pose, translation
from common.rotations import rotation_about
from leap_rig.report.recorder import Recorder
from leap_rig.report.report import as_text, summarise

ON_TABLE, IN_HAND = ("table",), ("reflex/distal_1", "reflex/distal_3")
STANDS = translation(0.44, -0.44, 0.13)


def seen(*sights, scenario=None):
    """The recorder after sights, (pose, clearance, touches), one a second from 10 s on."""
    recorder = Recorder()
    recorder.start(10.0)
    recorder.scenario = scenario
    for k, (T, clearance, touches) in enumerate(sights):
        recorder.add_object("cup", T, clearance, touches, 10.0 + k)
    return recorder


def lifted(height):
    return translation(0.0, 0.0, height) @ STANDS


PICKED = (
    (STANDS, 0.0, ON_TABLE),
    (lifted(0.2), 0.2, IN_HAND),
    (translation(0.01, 0.0, 0.0) @ STANDS, 0.0, (*ON_TABLE, *IN_HAND)),
    (translation(0.01, 0.0, 0.0) @ STANDS, 0.0, ON_TABLE),
)
DONE = {"scenario": "pick_cup", "step": "done", "failure": ""}


def summary_of(recorder):
    return summarise(recorder, 20.0)


def test_an_object_that_was_picked_and_put_down():
    summary = summary_of(seen(*PICKED, scenario=DONE))
    cup = summary["objects"]["cup"]
    assert cup["picked_and_placed"] and not cup["fell"]
    assert (cup["left_the_table_s"], cup["lifted_mm"], cup["put_down_s"], cup["moved_mm"]) == (1.0, 200.0, 3.0, 10.0)
    assert "left the table at 1.0 s, was lifted 200 mm, put down at 3.0 s, 10 mm from where" in as_text(summary)
    assert not any("scenario" in fault for fault in summary["faults"])


@pytest.mark.parametrize(
    "sights, sentence",
    [
        (PICKED[:1], "cup: stayed on the table, moved by 0 mm"),
        (PICKED[:2], "was not put down"),
        (PICKED[:3], "was not put down"),
        ((*PICKED, (lifted(0.1), 0.1, IN_HAND)), "was not put down"),
        ((*PICKED[:2], (translation(0, 0, -0.8), -0.8, ("floor",))), "cup: fell off the table"),
        ((*PICKED, (translation(0, 0, -0.8), -0.8, ("floor",))), "cup: fell off the table"),
        ((*PICKED[:2], (STANDS @ pose(rotation_about(0, np.radians(90.0))), 0.0, ON_TABLE)), "tilted by 90 deg"),
    ],
    ids=["not touched", "still up", "not let go", "up again", "fell", "fell after it stood", "tipped over"],
)
def test_what_is_not_picked_and_placed_is_a_fault_of_the_scenario(sights, sentence):
    summary = summary_of(seen(*sights, scenario=DONE))
    assert not summary["objects"]["cup"]["picked_and_placed"]
    assert sentence in as_text(summary)
    assert "The scenario pick_cup picked up and put down nothing." in summary["faults"]


@pytest.mark.parametrize(
    "scenario, height, fault",
    [
        ("pick_cup", 0.012, "The scenario pick_cup lifted by only 12 mm instead of 195 mm."),
        ("pick_cup", 0.194, "The scenario pick_cup lifted by only 194 mm instead of 195 mm."),
        ("pick_cup", 0.195, None),
        ("assisted_grasp", 0.1, None),
    ],
)
def test_a_scenario_lifts_as_high_as_it_says(scenario, height, fault):
    sights = (PICKED[0], (lifted(height), height, IN_HAND), *PICKED[2:])
    faults = summary_of(seen(*sights, scenario={**DONE, "scenario": scenario}))["faults"]
    assert [sentence for sentence in faults if "scenario" in sentence] == ([] if fault is None else [fault])


def test_a_scenario_that_was_given_up_says_why():
    given_up = {"scenario": "pick_cup", "step": "down", "failure": "the arm did not follow"}
    assert (
        "The scenario pick_cup was not finished: the arm did not follow."
        in summary_of(seen(scenario=given_up))["faults"]
    )
    cut_off = {**given_up, "failure": ""}
    assert (
        "The scenario pick_cup was not finished: it ended at step 'down'."
        in summary_of(seen(scenario=cut_off))["faults"]
    )


def test_a_scenario_is_over_when_it_is_done_or_given_up():
    recorder = Recorder()
    assert not recorder.scenario_over
    recorder.scenario = {**DONE, "step": "lift"}
    assert not recorder.scenario_over
    for last in (DONE, {**DONE, "step": "lift", "failure": "no"}):
        recorder.scenario = last
        assert recorder.scenario_over


def test_without_a_scenario_objects_are_no_fault():
    assert not any("scenario" in fault for fault in summary_of(seen(*PICKED[:1]))["faults"])
