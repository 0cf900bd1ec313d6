"""What policies see and say, their file, and what is learned from which rows."""

from __future__ import annotations

import io
import re
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from common.camera_model import pinhole
from common.errors import RigError
from common.poses import pose
from common.rotations import rotation_about, rotation_from_zyx
from leap_rig.policy.view import (
    ABOVE_M,
    ACTION,
    BELOW_M,
    CELL_M,
    CELLS,
    STATE,
    STRIDE,
    DepthView,
    action_numbers,
    desired_tool,
    height_map,
    state_numbers,
)

pytest.importorskip("torch")
import torch
from recordings import START, stored, write_recording
from test_recording_export import seen_and_felt

from leap_rig.policy.network import PolicyAbout, PolicyNetwork, loaded, saved
from leap_rig.policy.training import CHUNK, Samples, samples, trained, upcoming
from leap_rig.recording.recording_files import RecordingFault, messages
from leap_rig.recording.session import EpisodeLabel, episode_folder, write_label

ABOUT = PolicyAbout("Pick the cup up", 10, CHUNK, 3, True, True)
ANGLE, SMALL, PLACE = st.floats(-3.0, 3.0), st.floats(-0.4, 0.4), st.floats(-0.3, 0.3)
DOWN = rotation_about(0, np.pi)


def tool(yaw=0.0, tilt=0.0, p=(0.4, -0.3, 0.3)):
    return pose(rotation_from_zyx(yaw, tilt, 0.0) @ DOWN, np.array(p))


def moved(turn, by):
    """A turn of the whole scene about the vertical, and a shift on the table."""
    return pose(rotation_about(2, turn), np.array([*by, 0.0]))


@settings(max_examples=40)
@given(ANGLE, SMALL, ANGLE, PLACE, PLACE)
def test_a_scene_that_is_turned_and_shifted_with_the_tool_looks_and_is_done_alike(yaw, tilt, turn, dx, dy):
    T, M = tool(yaw, tilt), moved(turn, (dx, dy))
    goal = tool(yaw + 0.3, -tilt, (0.45, -0.2, 0.25))
    fingers, contacts = np.arange(4.0), np.zeros((3, 9))
    assert_allclose(action_numbers(M @ T, M @ goal, fingers), action_numbers(T, goal, fingers), atol=1e-5)
    assert_allclose(state_numbers(M @ T, fingers, contacts), state_numbers(T, fingers, contacts), atol=1e-5)
    # In the middle of cells, or rounding would decide.
    level = np.array([[0.105, -0.055, -0.1], [0.105, -0.055, -0.2], [-0.205, 0.005, -0.3]])
    points = level @ rotation_about(2, np.arctan2(T[1, 0], T[0, 0])).T + T[:3, 3]
    seen = height_map(points @ M[:3, :3].T + M[:3, 3], M @ T)
    assert_allclose(seen, height_map(points, T), atol=1e-6)
    assert_allclose(seen[CELLS // 2 + 10, CELLS // 2 - 6], -0.1, atol=1e-6)
    assert_allclose(seen[CELLS // 2 - 21, CELLS // 2], -0.3, atol=1e-6)
    assert (seen > -BELOW_M).sum() == 2


@settings(max_examples=40)
@given(ANGLE, SMALL, ANGLE, PLACE, st.floats(0.5, 2.0))
def test_an_action_means_the_tool_that_it_was_made_of_whatever_the_length_of_its_axes(yaw, tilt, turn, dx, length):
    T, goal = tool(yaw, tilt), tool(turn, -tilt, (0.4 + dx, -0.3, 0.2))
    numbers = action_numbers(T, goal, np.zeros(4)).astype(float)
    numbers[3:9] *= length
    assert_allclose(desired_tool(T, numbers), goal, atol=1e-5)


@pytest.mark.parametrize("axes", [[1.0, 0, 0, 2.0, 0, 0], [0.0] * 6, [np.nan, 0, 0, 0, 1, 0]])
def test_numbers_that_are_no_orientation_are_refused(axes):
    with pytest.raises(ValueError, match="the policy's numbers are no orientation"):
        desired_tool(tool(), np.array([0.0, 0.0, 0.1, *axes, *[0.0] * 4]))


def test_the_map_shows_the_highest_points_between_its_bounds():
    T = tool()
    x, y = T[:2, 3]
    heights = [0.2, 0.25, 0.3 + ABOVE_M + 0.01, 0.3 - BELOW_M - 0.01]
    points = [[x + 0.002, y + 0.002, z] for z in heights] + [
        [x + dx, y + dy, 0.2] for dx, dy in np.kron(0.27 * np.eye(2), [[1.0], [-1.0]])
    ]
    seen = height_map(np.array(points), T)
    assert_allclose(seen.max(), -0.05, atol=1e-6)
    assert (seen > -BELOW_M).sum() == 1


def test_a_camera_sees_points_where_they_are():
    camera = pinhole("depth", 64, 48, [[60.0, 0, 31.5], [0, 60.0, 23.5], [0, 0, 1.0]])
    T = pose(rotation_about(0, np.pi), np.array([0.4, -0.3, 1.0]))
    depth = np.full((48, 64), np.nan)
    depth[10, 20], depth[11, 21], depth[20, 40], depth[0, 0] = 0.9, 0.9, 5.0, 0.0
    (point,) = DepthView(camera).points(depth, T)
    expected = T[:3, :3] @ (0.9 * np.array([(20 - 31.5) / 60.0, (10 - 23.5) / 60.0, 1.0])) + T[:3, 3]
    assert_allclose(point, expected) and STRIDE == 2
    with pytest.raises(ValueError, match="the depth image is 32 x 48 px, unlike its camera_info"):
        DepthView(camera).points(depth[:, :32], T)


def test_a_finger_feels_by_how_much_of_it_is_touched():
    contacts = np.zeros((3, 9))
    contacts[1, :3] = contacts[2] = 1.0
    state = state_numbers(tool(), np.arange(4.0), contacts.ravel())
    assert state.dtype == np.float32 and state.shape == (STATE,)
    assert_allclose(state[-3:], [0.0, 1.0 / 3.0, 1.0])
    assert_allclose(state[[0, 7, 8, 9, 10]], [0.3, 0.0, 1.0, 2.0, 3.0])


def test_a_policy_says_the_same_from_its_file():
    torch.manual_seed(0)
    network = PolicyNetwork(ABOUT).eval()
    network.action_mean += 0.5
    heights, state = np.zeros((CELLS, CELLS), np.float32), np.ones(STATE, np.float32)
    again = loaded(saved(network))
    assert again.about == ABOUT and again.act(heights, state).shape == (CHUNK, ACTION)
    assert_allclose(again.act(heights, state), network.act(heights, state))


def test_files_that_are_no_policy_are_refused_in_a_sentence():
    content = torch.load(io.BytesIO(saved(PolicyNetwork(ABOUT))), weights_only=True)
    about, state, no_policy = content["about"], content["state"], "The file holds no policy of this release: "
    for wrong, why in (
        ([1], "it holds a list, not a mapping."),
        ({**content, "schema": 2}, "its schema is 2, not 1."),
        ({"schema": 1, "features": 9}, f"its cells is None, not {CELLS}."),
        ({**content, "cells": torch.zeros(3)}, "its cells is tensor"),
        ({**content, "about": {}}, "about/task is missing"),
        ({**content, "about": {**about, "task": 7}}, "about/task is 7, but must be a string"),
        ({**content, "about": {**about, "fps": 0}}, "about/fps is 0, but must be a whole number in"),
        ({**content, "about": {**about, "chunk": 21}}, "about/chunk / fps is 2.1 s, but at most 2 s count."),
        ({**content, "about": {**about, "chunk": 8}}, "its numbers are those of another network."),
        ({**content, "state": [1]}, "its numbers are those of another network."),
        (
            {**content, "state": {**state, "state_mean": state["state_mean"] * np.nan}},
            "its numbers are not all finite.",
        ),
        ({**content, "about": int}, "it is torn, or not a file of torch's numbers."),
    ):
        file = io.BytesIO()
        torch.save(wrong, file)
        with pytest.raises(RigError, match=re.escape(no_policy + why)):
            loaded(file.getvalue())
    whole = saved(PolicyNetwork(ABOUT))
    for data in (b"", b"nothing", whole[: len(whole) // 2], whole[:-9]):
        with pytest.raises(RigError, match=no_policy + "it is torn"):
            loaded(data)


@given(st.lists(st.booleans(), min_size=1, max_size=60))
def test_a_chunk_ends_where_no_hand_leads_and_holds_its_last_action(led):
    index, there = upcoming(np.array(led))
    for i in range(len(led)):
        run = 0
        while run < CHUNK and i + 1 + run < len(led) and led[i + 1 + run]:
            run += 1
        assert there[i].sum() == run and there[i][:run].all()
        if run:
            assert_allclose(index[i], i + 1 + np.minimum(np.arange(CHUNK), run - 1))


def blobs(count, rng):
    """Rows in which the tool shall go to the only thing in view."""
    cells, maps = rng.integers(6, CELLS - 6, (count, 2)), np.full((count, CELLS, CELLS), -BELOW_M)
    for one, (row, column) in zip(maps, cells):
        one[row - 3 : row + 4, column - 3 : column + 4] = -0.2
    actions = np.zeros((count, CHUNK, ACTION), np.float32)
    actions[:, :, :2] = CELL_M * (cells + 0.5 - CELLS / 2)[:, None]
    state = np.zeros((count, STATE), np.float32)
    return Samples(maps.astype(np.float16), state, actions, np.ones((count, CHUNK), bool))


def test_a_policy_learns_to_go_to_what_it_sees_where_nothing_was_shown():
    rng, losses = np.random.default_rng(0), []
    shown, new = [blobs(100, rng), blobs(100, rng)], blobs(50, rng)
    network = trained(shown, ABOUT, 250, 1, losses.append)
    assert len(losses) == 250
    wanted = new.actions[:, 0, :2]
    off = np.linalg.norm(places_said(network, new) - wanted, axis=1)
    assert np.median(off) < 0.01 < 0.1 * np.median(np.linalg.norm(wanted, axis=1))
    blind = trained(shown, replace(ABOUT, map=False), 30, 1, losses.append)
    assert np.ptp(places_said(blind, new), axis=0).max() < 1e-9


def places_said(network, new):
    acts = [network.act(one.astype(np.float32), state) for one, state in zip(new.maps, new.state)]
    return np.array(acts)[:, 0, :2]


def test_rows_that_no_hand_led_are_not_learned_from():
    rng = np.random.default_rng(0)
    good, bad = blobs(60, rng), blobs(60, rng)
    bad = bad._replace(actions=bad.actions + 1e3, there=np.zeros_like(bad.there))
    heights, state = good.maps[0].astype(np.float32), good.state[0]
    alone, both = (trained(parts, ABOUT, 5, 1, lambda _: None).act(heights, state) for parts in ([good], [good, bad]))
    assert_allclose(alone, both)


def seen_episode(folder, info_at=0.0, camera=True, tool_until=1.0, desired_until=1.0, task="lift", **changes):
    """An episode of 1 s in which a hand leads the tool for 0.7 s over a table, which is 50 mm lower after half of it;
    the fingers' commands are the time, 20 ms late; `changes` of its camera_info."""
    import rospy
    from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
    from sensor_msgs.msg import CameraInfo, Image
    from std_msgs.msg import Header
    from tf2_msgs.msg import TFMessage

    from reflex_msgs.msg import RadianServoCommands
    from rig_msgs.msg import TeleopState

    others = "/leap_kuka/state", "/camera/depth/image", "/tf", "/reflex_takktile/radian_hand_command"
    felt = messages(seen_and_felt(folder.with_name(f"{folder.name}_felt")) / "messages.mcap")
    found = [one for one in felt if one.topic not in others]
    stamp = rospy.Time(0, START)
    K = [60.0, 0, 47.5, 0, 60.0, 31.5, 0, 0, 1.0]
    info = CameraInfo(header=Header(0, stamp, "camera"), height=64, width=96, distortion_model="plumb_bob", K=K)
    info.D, info.R, info.P = [0.0] * 5, np.eye(3).ravel().tolist(), [*K[:3], 0, *K[3:6], 0, *K[6:], 0]
    for name, value in changes.items():
        setattr(info, name, value)
    found.append(stored("/camera/depth/camera_info", info, info_at))

    def frame(child, p, q, at=0.0):
        return TransformStamped(
            Header(0, stamp + rospy.Duration.from_sec(at), "kuka/base_frame"),
            child,
            Transform(Vector3(*p), Quaternion(*q)),
        )

    # The camera looks down on a table that is 0.7 m below it; the tool is 0.2 m above the table.
    if camera:
        found.append(stored("/tf_static", TFMessage([frame("camera", (0.4, 0.0, 1.0), (1.0, 0.0, 0.0, 0.0))]), 0.0))
    for i in range(20):
        at = 0.05 * i
        mm = np.full((64, 96), 700 if i < 10 else 750, "<u2")
        depth = Image(Header(0, stamp, "camera"), 64, 96, "16UC1", 0, 192, mm.tobytes())
        found.append(stored("/camera/depth/image", depth, at))
        found.append(stored("/reflex_takktile/radian_hand_command", RadianServoCommands([at] * 4), at + 0.02))
        tools = [frame(f"kuka/tool_frame/{name}", (0.4 + ahead, 0.0, 0.5), (1.0, 0.0, 0.0, 0.0), at)
                 for name, ahead, until in (("measured", 0.0, tool_until), ("desired", 0.01 * i, desired_until))
                 if at < until]  # fmt: skip
        found.append(stored("/tf", TFMessage(tools), at))
        found.append(stored("/leap_kuka/state", TeleopState(state="running", follows=i < 14), at))
    return write_recording(folder, sorted(found, key=lambda one: one.received), name="x", task=task)


@pytest.mark.ros
def test_an_episode_gives_rows_as_the_camera_and_the_hand_had_them(tmp_path):
    with pytest.raises(RecordingFault, match="no depth images with their camera_info"):
        samples(seen_and_felt(tmp_path / "blind"))
    one, task = samples(seen_episode(tmp_path / "made"))
    assert task == "lift"
    seen = [float(np.median(row[row > -0.39])) for row in one.maps]
    assert_allclose(seen, [-0.2] * 5 + [-0.25] * (len(seen) - 5), atol=0.002)
    # The commands that were due at the rows after the second one.
    assert_allclose(one.actions[1, :4, -4:], [[at] * 4 for at in (0.15, 0.25, 0.35, 0.45)], atol=1e-6)
    assert one.there[:3, 0].all() and not one.there[-3:].any()
    step = one.actions[1, 2, 0] - one.actions[1, 0, 0]
    assert 0.03 < step < 0.05, "two rows of 0.1 s, in which it goes 0.04 m"
    assert one.actions[1, 0, 0] == pytest.approx(0.04, abs=0.005), "the desired tool of the next row"


@pytest.mark.ros
@pytest.mark.parametrize("until", [{"tool_until": 0.3}, {"desired_until": 0.4}])
def test_rows_without_a_fresh_tool_are_not_learned_from(tmp_path, until):
    one, _ = samples(seen_episode(tmp_path / "made", **until))
    assert one.there[:4, 0].all() and not one.there[5:].any()


@pytest.mark.ros
def test_where_no_hand_led_nothing_is_learned(tmp_path):
    from leap_rig.policy.ros import train_program

    words = [str(seen_episode(tmp_path / "made", tool_until=0.0)), "--out", str(tmp_path / "made.pt")]
    with pytest.raises(RecordingFault, match="No row of these recordings was led by a hand"):
        train_program.train(train_program._parser().parse_args(words))


@pytest.mark.ros
def test_the_first_rows_have_the_camera_info_that_comes_after_them(tmp_path):
    one, _ = samples(seen_episode(tmp_path / "made", info_at=0.25))
    assert (one.maps[0] > -0.39).any()


@pytest.mark.ros
@pytest.mark.parametrize(
    "changes, why",
    [
        ({"K": [0.0] * 9}, "the camera is not calibrated"),
        ({"K": [np.nan] * 9}, "the numbers of the camera_info are not finite"),
        ({"width": 320, "height": 240}, "the image is 96 x 64, but its camera_info says 320 x 240"),
        ({"distortion_model": "fisheye"}, "the distortion model 'fisheye'"),
        ({"camera": False}, "does not say where camera is"),
    ],
)
def test_an_episode_whose_depth_has_no_place_is_refused_in_a_sentence(tmp_path, changes, why):
    with pytest.raises(RecordingFault, match=why):
        samples(seen_episode(tmp_path / "made", **changes))


@pytest.mark.ros
def test_a_policy_is_of_one_task_which_can_be_said_again(tmp_path, capsys):
    from leap_rig.policy.ros import train_program

    def train(*words):
        return train_program.train(train_program._parser().parse_args([*words, "--steps", "2"]))

    for i, task in enumerate(("lift", "lift it", "")):
        (tmp_path / str(i)).mkdir()
        seen_episode(tmp_path / str(i) / "one", task=task)
    one, other, silent = (str(tmp_path / str(i) / "one") for i in range(3))
    out = tmp_path / "made.pt"
    with pytest.raises(RecordingFault, match="one shows 'lift it', but .*one 'lift', and a policy has one task"):
        train(one, other, "--out", str(out))
    with pytest.raises(RecordingFault, match="does not say what is done; give --task"):
        train(silent, "--out", str(out))
    assert not out.exists()
    assert train(one, other, silent, "--out", str(out), "--task", "Lift it.", "--without", "touch") == 0
    about = loaded(out.read_bytes()).about
    assert (about.task, about.episodes, about.touch, about.map) == ("Lift it.", 3, False, True)
    assert "from 3 episodes with 18 rows that a hand led" in capsys.readouterr().out
    with pytest.raises(RecordingFault, match="exists already"):
        train(one, "--out", str(out))


@pytest.mark.ros
def test_of_sessions_the_successes_are_learned_from_and_a_seed_makes_one_policy(tmp_path):
    from leap_rig.policy.ros import train_program

    for number, outcome in enumerate(("success", "failure", "success")):
        folder = episode_folder(tmp_path / "cups", number)
        folder.parent.mkdir(exist_ok=True)
        write_label(seen_episode(folder, task=f"lift {number}"), EpisodeLabel(said=outcome))

    def train(name, *words):
        options = [str(tmp_path / "cups"), "--out", str(tmp_path / name), "--steps", "2", *words]
        train_program.train(train_program._parser().parse_args(options))
        return loaded((tmp_path / name).read_bytes())

    with pytest.raises(RecordingFault, match="00002 shows 'lift 2', but .*00000 'lift 0'"):
        train("mixed")
    one, again, other = (train(f"{i}.pt", "--episodes", "1", "--seed", seed) for i, seed in enumerate("550"))
    assert (one.about.task, one.about.episodes) == ("lift 0", 1)
    heights, state = np.zeros((CELLS, CELLS), np.float32), np.ones(STATE, np.float32)
    assert_allclose(one.act(heights, state), again.act(heights, state))
    assert np.abs(one.act(heights, state) - other.act(heights, state)).max() > 1e-3
