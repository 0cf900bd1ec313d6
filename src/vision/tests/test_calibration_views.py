"""Where the arm holds the marker board: every view is seen, reached and clear, and together they determine the
calibration."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from hand_eye_scene import SD, change

from apriltag_ros.settings import targets
from common.camera_model import from_calibration
from common.config import parse
from common.errors import ConfigError
from common.poses import inverse, pose
from common.rotations import rotation_about
from rig_description.urdf import urdf
from vision.calibration.acceptance import BoardDetection, CalibrationConfig, ViewRejected, judge, view_from
from vision.calibration.arm_model import SHIFT_TOLERANCE_M, ArmModel
from vision.calibration.view_planner import (
    ARM_RADIUS_M,
    EDGE_PX,
    OTHER_ARM_RADIUS_M,
    ViewPlanner,
    ViewsConfig,
    guessed_camera,
)
from vision.marker_board.board import MarkerBoardConfig

CONFIG = Path(__file__).parents[1] / "config"


def read(schema, name):
    return parse(schema, yaml.safe_load((CONFIG / name).read_text()))


@pytest.fixture(scope="module")
def arm():
    return ArmModel(urdf("LBR7R800", "MF_elektrisch"))


@pytest.fixture(scope="module")
def config():
    return replace(read(ViewsConfig, "calibration_views.yaml"), tries=400)


@pytest.fixture(scope="module")
def points():
    (target,) = targets(yaml.safe_load((CONFIG / "tags.yaml").read_text()))
    return np.concatenate([tag.corners for tag in target.tags])


@pytest.fixture(scope="module")
def planner(arm, config, points):
    board = read(MarkerBoardConfig, "panel.yaml")
    camera = from_calibration(yaml.safe_load((CONFIG / "xtion_rgb.yaml").read_text()))
    return ViewPlanner(config, arm, camera, points, board, np.eye(3))


@pytest.fixture(scope="module")
def guess(config):
    return guessed_camera(config, np.eye(3))


@pytest.fixture(scope="module")
def candidates(planner, guess):
    return planner.candidates(guess, np.random.default_rng(1))


@pytest.fixture(scope="module")
def views(planner, candidates, guess):
    return planner.choose(candidates, guess)


def test_inverse_kinematics_lead_to_the_wanted_place(arm):
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(30):
        q = rng.uniform(0.6 * arm.lower, 0.6 * arm.upper)
        wanted = arm.flange(q)
        reached = arm.joints_for(wanted, q + rng.uniform(-0.3, 0.3, 7))
        if reached is not None:
            found += 1
            assert np.all(reached >= arm.lower) and np.all(reached <= arm.upper)
            np.testing.assert_allclose(arm.flange(reached), wanted, atol=4 * SHIFT_TOLERANCE_M)
    assert found > 20
    assert arm.joints_for(pose(p=(3.0, 0.0, 0.0)), np.zeros(7)) is None


def test_the_spine_is_a_chain_of_known_lengths(arm):
    spine = arm.spine(np.radians([10, 20, 30, 40, 50, 60, 70]))
    lengths = np.linalg.norm(np.diff(spine, axis=0), axis=1)
    np.testing.assert_allclose(lengths, [0.34, 0.4, 0.4, 0.126 + 0.035], atol=1e-9)


def test_views_are_seen_tilted_and_clear(planner, arm, views, guess, config, points):
    assert len(views) >= 8
    board = read(MarkerBoardConfig, "panel.yaml")
    camera = from_calibration(yaml.safe_load((CONFIG / "xtion_rgb.yaml").read_text()))
    for view in views:
        T = inverse(guess) @ arm.flange(view) @ board.T_flange_tag
        ray = T[:3, 3] / np.linalg.norm(T[:3, 3])
        tilt = np.degrees(np.arccos(-T[:3, 2] @ ray))
        assert config.tilt[0] - 1.0 < tilt < config.tilt[1] + 1.0
        assert config.distance[0] - 0.01 < np.linalg.norm(T[:3, 3]) < config.distance[1] + 0.01
        pixels = camera.project(points @ T[:3, :3].T + T[:3, 3])
        assert np.all(pixels > EDGE_PX) and np.all(pixels < np.array([639.0, 479.0]) - EDGE_PX)
        assert planner.clearance(view, guess) > 0.0


def test_the_arm_keeps_away_from_a_second_one_that_stands_upright(arm, config, points, guess):
    """In the upright world, whatever the mounting: a turn of the base about the vertical turns the column with it."""
    board = read(MarkerBoardConfig, "panel.yaml")
    camera = from_calibration(yaml.safe_load((CONFIG / "xtion_rgb.yaml").read_text()))
    free = ViewPlanner(config, arm, camera, points, board, np.eye(3))
    q = np.radians([0.0, 90.0, 0.0, 0.0, 0.0, 0.0, 0.0])  # stretched out level, along x of the base
    flange = arm.flange(q)[:3, 3]
    for turn in (0.0, 40.0):
        R = rotation_about(2, np.radians(turn))
        ahead, left = R[:2, 0], R[:2, 1]
        for beside in (0.1, 0.24, 0.28, 0.6):
            where = 0.6 * flange[0] * ahead + beside * left
            planner = ViewPlanner(replace(config, other_arm=where), arm, camera, points, board, R)
            expected = min(beside - ARM_RADIUS_M - OTHER_ARM_RADIUS_M, free.clearance(q, guess))
            assert planner.clearance(q, guess) == pytest.approx(expected, abs=1e-6)
    passed = replace(config, other_arm=np.array([0.0, -0.4]))
    planner = ViewPlanner(passed, arm, camera, points, board, np.eye(3))
    here, there = (np.radians([turn, 60.0, 0.0, -60.0, 0.0, 60.0, 0.0]) for turn in (-20.0, -160.0))
    assert free.path_clear(here, there, guess) and not planner.path_clear(here, there, guess)


def test_the_chosen_views_are_surer_than_the_first_ones(planner, candidates, views, guess):
    def variance(views):
        total = sum(planner.information(view, guess) for view in views) + 1e-6 * np.eye(12)
        return np.trace(np.linalg.inv(total)[6:9, 6:9])

    assert variance(views) < variance(candidates[: len(views)])


def test_every_way_of_the_tour_and_back_is_clear(planner, views, guess, config):
    start = np.radians(config.start)
    legs = planner.tour(views, start, guess)
    assert len(legs) >= 8
    q = start
    for leg in legs:
        assert any(leg[-1] is view for view in views)
        for goal in leg:
            assert planner.path_clear(q, goal, guess)
            q = goal
    for goal in planner.path_back(start, legs, guess):
        assert planner.path_clear(q, goal, guess)
        q = goal
    np.testing.assert_allclose(q, start)


def test_a_way_through_the_table_is_not_clear_but_out_of_it_is(planner, guess, config):
    high = np.radians(config.start)
    low = np.radians([-45.0, 70.0, 0.0, -70.0, 0.0, 40.0, 0.0])
    assert planner.clearance(high, guess) > 0.0 > planner.clearance(low, guess)
    assert not planner.path_clear(high, low, guess)
    assert planner.path_clear(low, high, guess)


def test_back_on_its_own_track_where_the_straight_way_is_barred(planner, guess, config, monkeypatch):
    start, a, b = np.zeros(7), np.full(7, 0.1), np.full(7, 0.2)
    legs = [[a], [b]]
    home = np.radians(config.start)
    monkeypatch.setattr(planner, "path_clear", lambda q, goal, _: q[0] == 0.1)
    np.testing.assert_array_equal(planner.path_back(start, legs, guess), [a, home])
    monkeypatch.setattr(planner, "path_clear", lambda *_: False)
    assert planner.path_back(start, legs, guess) == []


def test_a_camera_that_is_far_away_sees_nothing(planner, config, monkeypatch):
    monkeypatch.setattr(planner, "_config", replace(config, tries=100))
    away = pose(rotation_about(0, np.pi), (0.0, 0.0, 6.0))
    assert planner.candidates(away, np.random.default_rng(0)) == []
    assert planner.choose([], away) == []


def test_the_guess_looks_at_its_target_under_any_mounting(config):
    for R in (np.eye(3), rotation_about(0, np.pi)):
        T = guessed_camera(config, R)
        world = pose(R) @ T
        ahead = config.guess_target - config.guess_position
        np.testing.assert_allclose(world[:3, 2], ahead / np.linalg.norm(ahead), atol=1e-12)
        np.testing.assert_allclose(world[:3, 3], config.guess_position, atol=1e-12)
        assert world[2, 0] == pytest.approx(0.0, abs=1e-12)
        assert world[2, 1] < 0.0, "y of an optical frame points down"


@pytest.mark.parametrize(
    ("key", "value"),
    [("tilt", [45, 20]), ("distance", [1.0, 1.0]), ("guess_target", [1.1, -0.1, 0.0])],
)
def test_faults_of_the_configuration(key, value):
    values = yaml.safe_load((CONFIG / "calibration_views.yaml").read_text())
    with pytest.raises(ConfigError, match=key):
        parse(ViewsConfig, {**values, key: value})


def test_the_shipped_settings_lead_to_an_accepted_calibration(arm, views, guess):
    """All planned views with the shipped number of images: the whole program is only tested with fewer."""
    board, limits = read(MarkerBoardConfig, "panel.yaml"), read(CalibrationConfig, "camera_calibration.yaml")
    assert (len(views), limits.pictures) == (15, 10)
    rng = np.random.default_rng(0)
    truth = guess @ pose(rotation_about(1, 0.02), (0.02, -0.03, 0.01))
    taken = []
    for view in views:
        T_base_flange = arm.flange(view)
        T = inverse(truth) @ T_base_flange @ board.T_flange_tag
        noise = rng.normal(0.0, 0.3 * SD, (limits.pictures, 6))
        detections = [BoardDetection(change(T, x), np.diag(SD**2)) for x in noise]
        with pytest.raises(ViewRejected) as caught:
            view_from(detections[1:], T_base_flange, taken, limits)
        assert caught.value.cause == "detections"
        taken.append(view_from(detections, T_base_flange, taken, limits))
    verdict = judge(taken, board.T_flange_tag, limits)
    assert verdict.accepted, verdict.sentence
    np.testing.assert_allclose(verdict.result.T_base_camera, truth, atol=2e-3)
