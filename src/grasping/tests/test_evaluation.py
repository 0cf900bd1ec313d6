"""What judges grasps: rectangles and the lifting."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from common import lift_trial
from common.poses import pose
from common.rotations import rotation_about, rotation_angle
from grasping.lab.evaluation import sheets, tables, trials
from grasping.lab.evaluation.lifting import lift, nearest_object
from grasping.lab.evaluation.trials import angle_between, is_right, judge, oracle, overlap, situation
from grasping.lab.synthetic import samples, scene
from grasping.lab.synthetic.scene import HeapScene, world_xml
from grasping.lab.synthetic.shapes import Geom
from grasping.network.maps import REFLEX, Peak
from grasping.poses.gripper import GRIPPER

DOWN = np.diag([1.0, -1.0, -1.0])


@given(st.floats(-10.0, 10.0), st.floats(-10.0, 10.0))
def test_angles_between_lines(a, b):
    d = angle_between(a, b)
    assert 0.0 <= d <= 0.5 * np.pi + 1e-9
    assert d == pytest.approx(angle_between(b, a), abs=1e-9)
    assert d == pytest.approx(angle_between(a + np.pi, b), abs=1e-6)


def test_overlap_of_rectangles():
    a = Peak(100, 100, 1.0, 0.3, 40.0)
    assert overlap(a, a) == pytest.approx(1.0, abs=1e-3)
    assert overlap(a, a._replace(row=200)) == 0.0
    level = a._replace(angle=0.0)
    assert overlap(level, level._replace(column=120)) == pytest.approx(1.0 / 3.0, abs=1e-3)
    assert overlap(level, level._replace(width=0.0)) == 0.0
    # The angle is anticlockwise: moved along itself, up and right, a rectangle still touches; the other way less.
    up = a._replace(angle=0.7)
    assert overlap(up, up._replace(row=87, column=115)) > overlap(up, up._replace(row=113, column=115)) + 0.05


def test_rectangle_metric_needs_angle_and_place():
    label = Peak(100, 100, 1.0, np.radians(80.0), 40.0)
    assert is_right(label._replace(angle=np.radians(-80.0)), [label])
    assert not is_right(label._replace(angle=np.radians(-65.0)), [label])
    assert not is_right(label._replace(column=140), [label])
    assert not is_right(label, [])


def box_scene():
    objects = ((Geom("box", (0.05, 0.015, 0.02)),),)
    state = np.array([0.0, 0.0, 0.02, 1.0, 0.0, 0.0, 0.0])
    return HeapScene(world_xml(objects), state, objects, ("box",))


ACROSS = DOWN @ rotation_about(2, 0.5 * np.pi)


@pytest.mark.parametrize(
    ("R", "place", "friction", "reason"),
    [
        (ACROSS, (0.0, 0.0, 0.04), 0.5, lift_trial.LIFTED),
        (DOWN, (0.0, 0.0, 0.04), 0.5, lift_trial.COLLISION),
        (ACROSS, (0.2, 0.0, 0.04), 0.5, lift_trial.MISSED),
        (ACROSS, (0.0, 0.0, 0.04), 0.01, lift_trial.SLIPPED),
    ],
    ids=["across", "along, where it is too long", "beside", "smooth"],
)
def test_lifting_a_bar(R, place, friction, reason):
    trial = lift(box_scene(), pose(R, place), 0.05, GRIPPER, friction)
    assert (trial.reason, trial.lifted) == (reason, reason == lift_trial.LIFTED)
    assert (trial.rise > 0.1) == trial.lifted


def test_only_the_object_that_was_meant_counts():
    bar = (Geom("box", (0.05, 0.015, 0.02)),)
    upright = 1.0, 0.0, 0.0, 0.0
    state = np.array([0.0, 0.0, 0.02, *upright, 0.0, 0.3, 0.02, *upright])
    two = HeapScene(world_xml((bar, bar)), state, (bar, bar), ("box", "box"))
    at_first = pose(ACROSS, (0.0, 0.0, 0.04))
    assert lift(two, at_first, 0.05, GRIPPER, 0.5, 0).lifted
    assert lift(two, at_first, 0.05, GRIPPER, 0.5, 1).reason == lift_trial.OTHER_OBJECT
    for point, nearest in (((0.0, 0.0, 0.041), 0), ((0.0, 0.29, 0.03), 1), ((0.1, 0.17, 0.0), 1), ((0.1, 0.13, 0), 0)):
        assert nearest_object(two, np.array(point)) == nearest


def test_a_shake_drops_what_the_fingers_just_hold(monkeypatch):
    monkeypatch.setattr(scene, "DENSITY", 7600.0)  # the bar weighs 8.9 N, and the fingers can carry 10 N
    grasp = pose(ACROSS, (0.0, 0.0, 0.04))
    assert lift(box_scene(), grasp, 0.05, GRIPPER, 0.5, 0).lifted
    assert lift(box_scene(), grasp, 0.05, GRIPPER, 0.5, 0, shake=True).reason == lift_trial.SHAKEN_OUT
    monkeypatch.undo()
    assert lift(box_scene(), grasp, 0.05, GRIPPER, 0.5, 0, shake=True).lifted


def test_the_arms_error_is_the_one_asked_for():
    of = situation("test", 2, 1)
    exact, usual, poor = (
        trials.executed(of, oracle(of), trials.Conditions(position_error=m, angle_error=rad)).T_world_grasp
        for m, rad in ((0.0, 0.0), (0.002, 0.035), (0.005, np.radians(5.0)))
    )
    misses = [np.linalg.norm(T[:3, 3] - exact[:3, 3]) for T in (usual, poor)]
    assert misses[1] == pytest.approx(2.5 * misses[0]) and misses[0] > 0.0
    turns = [rotation_angle(exact[:3, :3].T @ T[:3, :3]) for T in (usual, poor)]
    assert turns[1] == pytest.approx(np.radians(5.0) / 0.035 * turns[0])


def test_the_oracle_knows_the_grasps_of_the_hand_that_tries_them():
    of = situation("test", 2, 1, trials.Conditions(hand=REFLEX))
    label = samples.sample(of.view, samples.LabelSettings(REFLEX))
    np.testing.assert_array_equal(np.round(255.0 * of.best.quality), label.quality)
    found = oracle(of)
    assert label.quality[found.row, found.column] == label.quality.max() > 0


def test_the_oracle_lifts_what_it_labels():
    of = situation("test", 2, 1)
    chosen = oracle(of)
    outcome = judge(of, chosen)
    assert outcome.rectangle
    assert outcome.lifted
    assert judge(of, chosen) == outcome
    assert not judge(of, None).found


def row(scene, method, lifted, quality=0.5, reason=None, objects=None):
    reason = reason or (lift_trial.LIFTED if lifted else lift_trial.MISSED)
    objects = objects or (1 if scene % 2 else 4)
    cells = {"scene": scene, "objects": objects, "method": method, "lifted": lifted, "rectangle": True}
    return {**cells, "quality": quality, "reason": reason}


def test_table_of_results():
    rows = [row(i, "oracle", i < 9) for i in range(10)]
    assert "| oracle | 80 (38 to 96), n = 5 | 100 (57 to 100), n = 5 | 100" in tables.table(rows, ["oracle", "none"])
    assert "| none | - | - | - | - |" in tables.table(rows, ["oracle", "none"])


def test_differences_are_of_the_scenes_that_both_tried():
    rows = [row(i, "net", True) for i in range(10)] + [row(i, "other", i % 2 == 0) for i in range(9)]
    text = tables.differences(rows, ["other", "net"], ["net"])
    assert "| net - other | +100.0 (+100.0 to +100.0), n = 4 | +0.0 (+0.0 to +0.0), n = 5 | +44.4 (" in text
    assert "n = 9 |" in text and "other - " not in text
    assert tables.differences(rows, ["other"], []) == ""


@given(st.lists(st.tuples(st.booleans(), st.booleans()), min_size=1, max_size=12))
def test_a_difference_is_that_of_the_means(pairs):
    rows = [row(i, "a", a, objects=1) for i, (a, _) in enumerate(pairs)]
    rows += [row(i, "b", b, objects=1) for i, (_, b) in enumerate(pairs)]
    wanted = 100.0 * np.mean([float(b) - float(a) for a, b in pairs])
    text = tables.differences(rows, ["a", "b"], ["b"]).splitlines()[-1]
    assert float(text.split("|")[2].split()[0]) == pytest.approx(wanted, abs=0.06)


def test_several_trainings_are_compared_by_their_mean():
    rows = [row(i, f"net #{k}", i < 10 - k, objects=1) for k in (1, 2, 3) for i in range(10)]
    rows += [row(i, "old", i < 5, objects=1) for i in range(10)]
    methods = ["old", "net #1", "net #2", "net #3"]
    assert "| net, mean of 3 | 80 (" in tables.table(rows, methods)
    assert "n = 10 x 3 | - |" in tables.table(rows, methods)
    text = tables.differences(rows, methods, methods[1:])
    assert len(text.splitlines()) == 3
    assert "| net, mean of 3 - old | +30.0 (" in text


def test_every_failure_is_counted_once_under_its_reason():
    rows = [row(i, "net", False, reason=reason) for i, reason in enumerate(lift_trial.FAILURES)] + [row(9, "net", True)]
    cells = [c.strip() for c in tables.failures(rows, ["net"]).splitlines()[-1].split("|")[2:-1]]
    assert cells == ["1"] * len(lift_trial.FAILURES) + [str(len(rows))]


def red(path):
    image = cv2.imread(str(path)).astype(int)
    return int(((image[..., 2] > 150) & (image[..., 1] < 90)).sum())


def test_a_sheet_shows_each_failed_grasp(tmp_path):
    heights = np.full((300, 300), 0.05)
    failed = sheets.FailedGrasp(3, lift_trial.SLIPPED, heights, Peak(150, 140, 0.5, 0.3, 40.0), 0.07)
    drawn = []
    for count in (1, 2):
        path = tmp_path / f"{count}.png"
        sheets.failure_sheet(path, "net", 9, [failed.reason] * count, [failed] * count)
        drawn.append(red(path))
    assert 0 < 1.9 * drawn[0] < drawn[1]
    sheets.failure_sheet(path, "net", 9, [lift_trial.NO_GRASP], [failed._replace(peak=None)])
    assert red(path) == 0
    sheets.failure_sheet(path, "net", 9, [], [])
    assert path.stat().st_size > 1000


def test_the_drawn_grasp_is_the_grasp():
    (x, y, _), *fingers = sheets._lines(Peak(100, 50, 1.0, np.radians(90.0), 20.0))
    np.testing.assert_allclose(sorted(zip(x, y)), [(50.0, 90.0), (50.0, 110.0)], atol=1e-9)
    for finger, at in zip(fingers, y):
        np.testing.assert_allclose(finger[1], at, atol=1e-9)


def test_reliability_shows_what_was_lifted(tmp_path):
    quality, path = list(np.linspace(0.2, 0.8, 30)), tmp_path / "reliability.png"
    sheets.reliability_plot(path, {"net": (quality, [q > 0.5 for q in quality]), "few": ([0.5], [True])})
    first = path.read_bytes()
    sheets.reliability_plot(path, {"net": (quality, [q < 0.5 for q in quality]), "few": ([0.5], [True])})
    assert path.read_bytes() != first


def test_calibration_counts_each_grasp_once():
    rows = [{"method": "net", "quality": q, "lifted": q > 0.35} for q in (-0.1, 0.3, 0.39, 0.55, 0.6, 0.9)]
    text = tables.calibration(rows, ["net"])
    cells = [c.strip() for c in text.splitlines()[-1].split("|")[2:-1]]
    assert [c.rsplit(" ", 1)[-1] for c in cells] == ["1", "2", "-", "1", "2"]
    assert cells[1].startswith("50 (")
