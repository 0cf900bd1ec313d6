"""What a run's summary says, and when it calls the run failed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common.poses import pose, translation
from common.reasons import ReasonCode
from common.rotations import rotation_about
from leap_rig.report.processor import ProcessorLoad, cpu_times
from leap_rig.report.recorder import Recorder
from leap_rig.report.report import as_text, summarise


def good_run() -> Recorder:
    recorder = Recorder()
    recorder.status("kuka_control", {"goals_sent": "100", "pickups": "0"})
    recorder.status("leap_hand", {"commands_sent": "5"})
    recorder.status("simulation", {"stops": "0", "peak_tcp_speed": "0.5213"})
    recorder.start(10.0)
    recorder.stream(True, "palm in the box", 11.0)
    for i in range(101):
        stamp = 1000.0 + 0.01 * i
        recorder.stage("received", stamp, stamp + 0.0005)
        recorder.stage("leap_motion", stamp, stamp + 0.001)
        recorder.stage("leap_kuka", stamp, stamp + 0.003)
        recorder.stage("kuka_control", stamp, stamp + 0.004 + 1e-5 * i)
        tool = translation(0.4 + 0.001 * i, 0.0, 0.4)
        recorder.tool(tool, tool @ translation(0.0, 0.003, 0.004), tool @ pose(rotation_about(2, np.radians(2.0))))
    recorder.stream(False, "hand lost", 15.0)
    recorder.status("kuka_control", {"goals_sent": "1100", "pickups": "1"})
    recorder.status("leap_hand", {"commands_sent": "305"})
    recorder.status("simulation", {"stops": "0", "peak_tcp_speed": "0.25"})
    recorder.status("simulation", {"stops": "0", "peak_tcp_speed": "0.1"})
    recorder.hand(np.array([0.0, 0.0, 0.0, 0.0]))
    recorder.hand(np.array([1.0, 0.5, 0.2, 0.0]))
    return recorder


def test_a_good_run():
    summary = summarise(good_run(), 20.0)
    assert summary["faults"] == []
    assert summary["duration_s"] == 10.0
    assert summary["frames_received"] == 101
    assert summary["streams"] == [{"started_s": 1.0, "stopped_s": 5.0, "reason": "hand lost"}]
    assert summary["servo_goals_sent"] == 1000, "what was sent before the run began does not count"
    assert (summary["pickups"], summary["hand_commands"], summary["safety_stops"]) == (1, 300, 0)
    assert summary["largest_tcp_speed_mm_s"] == 250.0, "the motion home before the run does not count"
    assert summary["tool_path_m"] == pytest.approx(0.1)
    assert summary["hand_travel_rad"] == [1.0, 0.5, 0.2, 0.0]
    assert summary["tracking_error"]["desired"]["rms_mm"] == pytest.approx(5.0)
    assert summary["tracking_error"]["desired"]["max_deg"] == 0.0
    assert summary["tracking_error"]["commanded"]["rms_deg"] == pytest.approx(2.0)
    assert summary["tracking_error"]["commanded"]["max_mm"] == 0.0


def test_delays_are_taken_frame_by_frame_and_stage_by_stage():
    delays = summarise(good_run(), 20.0)["delay_ms"]
    assert delays["Leap service: frame sent late"]["p50"] == 0.5
    assert delays["leap_motion: received to published"] == {"p50": 0.5, "p95": 0.5, "p99": 0.5, "samples": 101}
    assert delays["leap_kuka: published to desired tool"]["p50"] == 2.0
    assert delays["frame received to goal on the arm's wire"]["p50"] == 4.0
    assert delays["frame received to goal on the arm's wire"]["p99"] == 4.49
    assert delays["frame received to command of the hand"] == {"p50": None, "p95": None, "p99": None, "samples": 0}


def test_the_delay_from_hand_to_arm_is_stated_where_enough_moved():
    assert summarise(good_run(), 20.0)["hand_to_arm_ms"] is None
    recorder = good_run()
    for i in range(2000):
        t = 0.01 * i
        recorder.palms.add(t, (0.1 * np.sin(t), 0.05 * np.sin(1.7 * t), 0.0))
        recorder.tools.add(t + 0.08, (0.0, 0.1 * np.sin(t), 0.05 * np.sin(1.7 * t)))
    summary = summarise(recorder, 20.0)
    assert summary["hand_to_arm_ms"]["p50"] == pytest.approx(80.0, abs=0.5)
    assert "hand to arm            80 ms" in as_text(summary) and "80 to 80 ms in 80 % of " in as_text(summary)


def test_a_frame_that_a_stage_dropped_is_not_counted():
    recorder = Recorder()
    for stage in ("received", "leap_motion"):
        recorder.stage(stage, 1.0, 1.1)
        recorder.stage(stage, 2.0, 2.1)
    recorder.stage("kuka_control", 2.0, 2.5)
    assert summarise(recorder, 0.0)["delay_ms"]["frame received to goal on the arm's wire"]["samples"] == 1


def test_the_summary_survives_json():
    summary = summarise(good_run(), 20.0)
    assert json.loads(json.dumps(summary)) == summary


def test_an_empty_run_failed_and_can_be_printed():
    summary = summarise(Recorder(), 0.0)
    assert summary["faults"] == ["The arm never followed a hand.", "The robot hand never moved."]
    assert "unknown" in as_text(summary)
    json.dumps(summary)


@pytest.mark.parametrize("moved", [True, False])
def test_without_a_tracker_a_node_moves_the_arm_or_none_does_and_neither_is_a_fault(moved):
    recorder = Recorder(teleoperated=False)
    recorder.status("kuka_control", {"goals_sent": "0"})
    recorder.start(10.0)
    recorder.status("kuka_control", {"goals_sent": "100" if moved else "0"})
    for i in range(50 * moved):
        recorder.tool(translation(0.001 * i, 0.0, 0.4), None, translation(0.001 * i, 0.0, 0.4))
    summary = summarise(recorder, 20.0)
    assert summary["faults"] == [] and not summary["teleoperated"]
    said = "The arm followed, no node died." if moved else "No node moved the arm by the desired tool frame, no node"
    assert said in as_text(summary)


def test_a_dead_node_fails_the_run():
    summary = summarise(good_run(), 20.0, ["leapd ended with exit code -9"])
    assert summary["faults"] == ["A node died: leapd ended with exit code -9."]
    assert "FAULT: A node died: leapd" in as_text(summary)


@pytest.mark.parametrize("teleoperated", [True, False])
def test_an_arm_far_from_its_target_does_not_follow(teleoperated):
    recorder = good_run()
    recorder.teleoperated = teleoperated
    for _ in range(200):
        recorder.tool(translation(0.5, 0.0, 0.4), None, translation(0.5, 0.1, 0.4))
    assert "did not follow" in summarise(recorder, 20.0)["faults"][0]


def test_motion_without_a_hand_is_no_following():
    recorder = good_run()
    recorder.tool_path = 0.0
    for i in range(100):
        recorder.tool(translation(0.01 * i, 0.0, 0.4), None, None)
    assert "The arm never followed a hand." in summarise(recorder, 20.0)["faults"]


def test_the_report_fits_one_screen():
    recorder = good_run()
    for i in range(50):
        recorder.stream(True, "palm in the box", 20.0 + 2 * i)
        recorder.stream(False, "hand lost, and a long reason " * 5, 21.0 + 2 * i)
    text = as_text(summarise(recorder, 200.0))
    assert len(text.splitlines()) <= 40
    assert max(len(line) for line in text.splitlines()) <= 100


def test_a_stream_that_runs_at_the_start_of_the_run_counts():
    recorder = Recorder()
    recorder.stream(True, "palm in the box", 1.0)
    recorder.start(5.0)
    assert summarise(recorder, 6.0)["streams"] == [
        {"started_s": 0.0, "stopped_s": None, "reason": "still running when the run ended"}
    ]


@given(st.lists(st.booleans()))
def test_streams_never_overlap(events):
    recorder = Recorder()
    for i, running in enumerate(events):
        recorder.stream(running, "", float(i))
    for earlier, later in zip(recorder.streams, recorder.streams[1:]):
        assert earlier.stopped is not None and earlier.stopped <= later.started


def world_run(world_s: float, speed: str = "1.0") -> dict:
    """Returns the summary of a run of 60 s in which so much of the world's time passed."""
    recorder = good_run()
    recorder.status("simulated_world", {"world_s": "5.0", "wall_s": "1000.0", "speed": speed})
    recorder.start(10.0)
    recorder.status("simulated_world", {"world_s": str(5.0 + world_s), "wall_s": "1060.0", "speed": speed})
    return summarise(recorder, 70.0)


def test_a_world_that_keeps_its_time_is_nothing_to_speak_of():
    summary = world_run(59.4)
    assert (summary["real_time_factor"], summary["warnings"]) == (0.99, [])
    assert "real-time factor       0.99" in as_text(summary)
    assert world_run(118.0, "2.0")["warnings"] == []


def test_a_world_in_slow_motion_is_a_warning_that_says_why():
    summary = world_run(48.0)
    (warning,) = summary["warnings"]
    assert warning.startswith("The machine is too slow for the simulated world: 0.80 s of it passed in a second")
    assert f"  WARNING: {warning}" in as_text(summary).splitlines()
    assert len(world_run(60.0, "2.0")["warnings"]) == 1


def test_without_a_world_there_is_no_factor():
    summary = summarise(good_run(), 20.0)
    assert summary["real_time_factor"] is None and summary["warnings"] == []
    assert "real-time" not in as_text(summary)


def test_a_film_that_ended_is_a_warning_and_no_fault():
    summary = summarise(good_run(), 20.0, remarks=["The film was not taken to the end."])
    assert summary["faults"] == [] and summary["warnings"] == ["The film was not taken to the end."]
    assert "  WARNING: The film was not taken to the end." in as_text(summary)


def test_a_stream_lost_on_a_full_machine_is_a_warning_that_says_what_was_lacking():
    def lost(load: float, *codes: ReasonCode) -> dict:
        recorder = good_run()
        recorder.stream(True, "palm in the box", 16.0)
        recorder.stream(False, "why", 18.0, codes)
        recorder.loads = [(12.0, 1.0), (17.0, 0.4), (18.5, load), (25.0, 1.0)]
        return summarise(recorder, 30.0)

    (warning,) = lost(0.97, ReasonCode.TRACKER_SILENT)["warnings"]
    assert warning.startswith("The stream was lost at 8.0 s while 97 % of the processors were in use")
    assert lost(0.9, ReasonCode.TRACKER_SILENT)["warnings"] == [] and lost(0.97, ReasonCode.HAND_GONE)["warnings"] == []
    assert lost(0.97)["processor"] == {"median_percent": 98.5, "max_percent": 100.0, "full_s": 3}
    assert "processors             98 % in use (largest 100 %); full for 3 s" in as_text(lost(0.97))
    assert summarise(good_run(), 20.0)["processor"] is None


STAT = """cpu  {} 0 100 {} 50 0 0 0 7 0
cpu0 0 0 0 0 0 0 0 0 0 0
"""


def test_the_load_is_the_time_in_use_of_the_time_that_passed():
    texts = iter([STAT.format(100, 900), STAT.format(175, 1025), "", STAT.format(175, 1025)])
    load = ProcessorLoad(lambda: next(texts))
    assert load.sample(5.0) is None, "nothing to compare with yet"
    assert load.sample(5.9) is None
    assert load.sample(6.0) == pytest.approx(75.0 / 200.0)
    assert load.sample(7.0) is None, "the file could not be read"
    assert load.sample(8.0) is None, "no time has passed"
    busy, whole = cpu_times(Path("/proc/stat").read_text())
    assert 0 < busy <= whole
