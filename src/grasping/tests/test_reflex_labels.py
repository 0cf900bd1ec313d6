"""Labels for the ReFlex hand: laws of the grasps on height maps, and the hand's name in files and programs."""

from __future__ import annotations

import json
import multiprocessing.dummy
from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import torch
from height_maps import boxes_on_table
from test_programs import call

from grasping.lab.evaluation import lift_file
from grasping.lab.programs import find_grasps, make_dataset, train_ggcnn
from grasping.lab.synthetic import labels, reflex_labels, samples, scene
from grasping.lab.synthetic.samples import LabelSettings
from grasping.network import weights
from grasping.network.maps import PARALLEL, REFLEX
from grasping.network.networks import NETWORKS
from grasping.poses.gripper import GRIPPER

CELL = samples.CELL_M
N = 141
TABLE = np.full((N, N), 0.7)
HAND = reflex_labels.Hand()
DIRECTIONS = 4
MIDDLE = N // 2, N // 2
BAR = (0.0, 0.0, 0.02, 0.05, 0.05)


def heights(*boxes):
    return boxes_on_table(N, boxes)


def found(*boxes, hand=HAND):
    return reflex_labels.grasps(heights(*boxes), TABLE, CELL, hand, DIRECTIONS)


def across(*boxes, hand=HAND):
    """Returns score and opening in the middle of the map, the fingers closing along x."""
    score, opening = reflex_labels.along_rows(heights(*boxes), TABLE, CELL, hand)
    return float(score[MIDDLE]), float(opening[MIDDLE])


@pytest.fixture(name="surface", params=[1, 2])
def surface_fixture(request):
    """Three boxes near the middle, each somewhere else."""
    rng = np.random.default_rng(request.param)
    low, high = (-0.03, -0.03, 0.006, 0.006, 0.02), (0.03, 0.03, 0.02, 0.02, 0.08)
    return heights(*rng.uniform(low, high, (3, 5)))


def scores(surface):
    return reflex_labels.grasps(surface, TABLE, CELL, HAND, DIRECTIONS).scores


def same(a, b):
    """Whether labels agree within two cells, which a turn rounds otherwise."""
    kernel = np.ones((5, 5), np.uint8)
    for one, other in ((a, b), (b, a)):
        near = np.stack([cv2.dilate(np.ascontiguousarray(layer), kernel) for layer in other])
        if np.mean((one > near + 0.1)[one > 0.1]) > 0.1:
            return False
    return True


def test_labels_move_with_the_scene(surface):
    moved = scores(np.roll(surface, (7, -11), (0, 1)))
    np.testing.assert_allclose(np.roll(scores(surface), (7, -11), (1, 2)), moved, atol=1e-6)
    assert moved.max() > 0.3


@pytest.mark.parametrize("quarters", [1, 2])
def test_labels_turn_with_the_scene(surface, quarters):
    """Half a turn also swaps the sides of the thumb: a label does not know them."""
    turned = scores(np.rot90(surface, quarters).copy())
    assert same(np.roll(np.rot90(scores(surface), quarters, (1, 2)), quarters * DIRECTIONS // 2, 0), turned)


def test_a_mirrored_scene_has_mirrored_labels(surface):
    wanted = scores(surface)[(-np.arange(DIRECTIONS)) % DIRECTIONS][:, :, ::-1]
    assert same(wanted, scores(surface[:, ::-1].copy()))


@pytest.mark.parametrize("height", [0.02, 0.06])
def test_what_is_wider_than_the_hand_has_no_label(height):
    """It goes through the whole map: the map's ends, which cut it, do not count."""
    middle = slice(N // 2 - 30, N // 2 + 30)
    assert found((0.0, 0.0, 0.064, 0.2, height)).scores[:, middle].max() == 0.0
    assert found((0.0, 0.0, 0.044, 0.2, height)).scores[:, middle].max() > 0.3


@pytest.mark.parametrize(
    ("half_x", "half_y", "height"), [(0.012, 0.04, 0.02), (0.03, 0.06, 0.06), (0.045, 0.035, 0.04)]
)
def test_a_bar_is_held_across_and_the_hand_opens_as_far_as_it_must(half_x, half_y, height):
    score, opening = across((0.0, 0.0, half_x, half_y, height))
    assert score > 0.8
    assert opening == pytest.approx(min(2.0 * half_x + 2.0 * HAND.clearance, 2.0 * HAND.preshape), abs=3.0 * CELL)


def test_the_table_forbids_what_is_too_flat_for_the_tips():
    assert across((0.0, 0.0, 0.02, 0.05, 0.009))[0] == 0.0
    assert across((0.0, 0.0, 0.02, 0.05, 0.02))[0] > 0.8


def test_neighbours_under_the_fingers_forbid():
    beside = [(side * 0.07, 0.0, 0.006, 0.008, 0.05) for side in (-1.0, 1.0)]
    assert across(BAR)[0] > 0.8
    assert 0.0 < across(BAR, beside[0])[0] <= 0.5
    assert across(BAR, (0.07, 0.0, 0.006, 0.06, 0.05))[0] == 0.0, "both fingers come down on it"


def test_a_neighbour_higher_than_the_palm_forbids():
    low, high = ((0.0, 0.055, 0.01, 0.01, height) for height in (0.10, 0.13))
    assert across((0.0, 0.0, 0.02, 0.03, 0.05), low)[0] > 0.3
    assert across((0.0, 0.0, 0.02, 0.03, 0.05), high)[0] == 0.0


def test_a_part_that_both_fingers_meet_is_worth_more_than_one_that_passes_between_them():
    both, between = (across((0.0, 0.0, 0.01, half, 0.05))[0] for half in (0.045, 0.012))
    one = across((0.0, 0.02, 0.01, 0.03, 0.05))[0]
    assert both > one > between == 0.0


def test_a_ridge_is_not_held_by_faces_that_lean_beyond_the_friction():
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    steep, flat = (np.minimum(TABLE, 0.7 - 0.03 + slope * np.abs(x)) for slope in (2.5, 0.5))
    for surface, held in ((steep, True), (flat, False)):
        surface[np.abs(y) > 0.06] = 0.7
        score = reflex_labels.grasps(surface, TABLE, CELL, HAND, 1).scores[0][MIDDLE]
        assert (score > 0.3) == held


def rod(radius):
    """Returns a height map of a round rod that lies along y."""
    c = CELL * (np.arange(N) - 0.5 * (N - 1))
    x, y = np.meshgrid(c, c)
    top = radius + np.sqrt(np.maximum(radius**2 - x**2, 0.0))
    return np.where((np.abs(x) < radius) & (np.abs(y) < 0.05), 0.7 - top, TABLE)


@pytest.mark.parametrize(("radius", "held"), [(0.009, False), (0.011, False), (0.016, True), (0.03, True)])
def test_the_fingers_slide_over_a_thin_rod_but_not_over_a_bar_of_its_height(radius, held):
    score, _ = reflex_labels.along_rows(rod(radius), TABLE, CELL, HAND)
    assert (score[MIDDLE] > 0.5) == held
    assert across((0.0, 0.0, radius, 0.05, 2.0 * radius))[0] > 0.8


@pytest.mark.parametrize("margin", [0.0, 0.008, 0.1])
def test_the_margin_widens_the_opening_alone_and_as_far_as_the_hand_opens(margin):
    score, opening = across(BAR)
    wider_score, wider = across(BAR, hand=HAND._replace(margin=margin))
    assert wider_score == score
    assert wider == pytest.approx(min(opening + margin, 2.0 * HAND.preshape), abs=1e-6)
    gripper = GRIPPER
    plain, more = (labels.grasps(heights(BAR), TABLE, CELL, g, 1) for g in (gripper, replace(gripper, margin=margin)))
    np.testing.assert_array_equal(plain.scores, more.scores)
    expected = np.where(plain.openings > 0.0, np.minimum(plain.openings + margin, gripper.opening), 0.0)
    np.testing.assert_allclose(more.openings, expected, atol=1e-6)


def test_the_map_lies_along_the_vertical_below_a_tilted_camera():
    seen = samples.view("train", 7, 1)
    above = scene.straight_above(seen.camera)
    assert seen.camera.R[2, 2] > -0.9999, "the camera is tilted"
    np.testing.assert_allclose(above.R.T @ above.R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(above.R[:, 2], [0.0, 0.0, -1.0])
    of_hand = samples.hand_grasps(seen, LabelSettings(REFLEX))
    # Each pixel's height, by the ray of the tilted camera, is that of its cell.
    n = samples.CELLS
    row, column = np.mgrid[:n, :n]
    cells = labels.Labels(above.position[2] - of_hand.surface, row, column, np.ones((n, n), bool))
    height = make_dataset.heights(seen, of_hand)
    label = of_hand.in_image(cells)
    on_object = height > 0.01
    visible = on_object & (label.quality > 0.0)
    assert visible.sum() > 0.5 * on_object.sum()
    assert np.abs(label.quality - height)[visible].max() < 2.0 * CELL + 1e-6


def test_a_checked_grasp_lies_on_an_object_and_is_the_same_for_both_hands():
    parallel, reflex = (make_dataset.scene_grasps("train", 5, LabelSettings(hand)) for hand in (PARALLEL, REFLEX))
    assert parallel["mjcf"] == reflex["mjcf"]
    tried = [next(g for g in one["grasps"] if g["method"] == make_dataset.RANDOM) for one in (parallel, reflex)]
    T = np.array([g["T_world_grasp"] for g in tried])
    np.testing.assert_allclose(T[0], T[1], atol=0.02)  # the angle of a direction is the same within the tilt
    assert T[0][2, 3] > labels.LOWEST_OBJECT_M
    best = next(g for g in reflex["grasps"] if g["method"] == make_dataset.BEST)
    assert 0.3 < best["peak"]["quality"] <= 1.0 and 0.0 < best["width"] <= 2.0 * HAND.preshape + 1e-6


def make(folder, split, hand, first=0):
    wanted = LabelSettings(hand, 0.008)
    path = folder / f"{split}_{first:06d}.npz"
    make_dataset.make_shard(make_dataset.ShardTask(path, split, range(first, first + 2), wanted))
    return path


@pytest.fixture(scope="module", name="shards")
def shards_fixture(tmp_path_factory):
    folder = tmp_path_factory.mktemp("reflex")
    for split in ("train", "validation"):
        make(folder, split, REFLEX)
    return folder


def test_the_hand_goes_from_the_shards_into_the_weights(shards, tmp_path, monkeypatch, capsys):
    with np.load(shards / "train_000000.npz") as shard:
        assert make_dataset.label_settings(shard) == LabelSettings(REFLEX, 0.008)
        assert shard["quality"].max() > 0
    options = ["--steps", "1", "--count", "2", "--side", "60", "--half", "false"]
    call(monkeypatch, train_ggcnn, shards, tmp_path / "run", *options)
    file = tmp_path / "run" / "weights.pt"
    assert weights.load(file.read_bytes()).hand == REFLEX
    assert json.loads((tmp_path / "run" / "settings.json").read_text())["hand"] == REFLEX
    np.save(tmp_path / "depth.npy", np.full((400, 400), 0.7))
    capsys.readouterr()
    with pytest.raises(SystemExit):
        call(monkeypatch, find_grasps, tmp_path / "depth.npy", file, "--hand", PARALLEL)
    sentence = "trained on grasps of the hand reflex, but the hand is parallel"
    assert sentence in capsys.readouterr().err
    call(monkeypatch, find_grasps, tmp_path / "depth.npy", file, "--hand", REFLEX)


def test_shards_of_two_hands_do_not_train_together(shards, tmp_path, monkeypatch, capsys):
    for path in shards.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    make(tmp_path, "train", PARALLEL, 2)
    with pytest.raises(SystemExit):
        call(monkeypatch, train_ggcnn, tmp_path, tmp_path / "run")
    text = capsys.readouterr().err
    assert "train_000000.npz for the hand reflex and train_000002.npz for the hand parallel" in text
    assert not (tmp_path / "run").exists()


def test_grasps_to_be_checked_go_to_a_file(tmp_path, monkeypatch):
    threads = SimpleNamespace(get_context=lambda _method: multiprocessing.dummy)
    monkeypatch.setattr(lift_file, "multiprocessing", threads)
    file = tmp_path / "check.json"
    call(monkeypatch, make_dataset, "--check", file, "--hand", REFLEX, "--split", "validation", "--scenes", "2")
    content = json.loads(file.read_text())
    assert content["schema"] == 2 and [one["scene"] for one in content["scenes"]] == [0, 1]
    assert {g["method"] for one in content["scenes"] for g in one["grasps"]} == {make_dataset.RANDOM, make_dataset.BEST}


@pytest.mark.parametrize(
    ("hand", "sentence"),
    [
        ("parallel", "holds labels of the hand reflex with a margin of 0.008 m, but parallel with 0 m"),
        ("reflex", "but reflex with 0 m"),
    ],
)
def test_labels_of_another_meaning_are_one_sentence(shards, monkeypatch, capsys, hand, sentence):
    monkeypatch.setattr(make_dataset, "SHARD", 2)
    before = sorted(p.stat().st_mtime_ns for p in shards.iterdir())
    with pytest.raises(SystemExit) as end:
        call(monkeypatch, make_dataset, shards, "--scenes", "2", "--hand", hand)
    assert end.value.code == 2 and sentence in capsys.readouterr().err
    assert sorted(p.stat().st_mtime_ns for p in shards.iterdir()) == before


def test_weights_of_a_hand_that_nobody_knows_are_refused(tmp_path):
    torch.save({**NETWORKS["ggcnn2"]().state_dict(), weights.HAND: torch.tensor([7.0])}, tmp_path / "weights.pt")
    with pytest.raises(weights.WeightsError, match="names the hand"):
        weights.load((tmp_path / "weights.pt").read_bytes())
