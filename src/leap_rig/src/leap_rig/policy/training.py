"""Training of a policy on recorded episodes, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import torch

from common.camera_model import camera_model_from_info, same_camera
from common.frames import BASE, frame_name
from common.plausible import plausible_depth
from common.poses import pose
from common.rotations import rotation_from_quaternion
from leap_rig.cockpit.frame_poses import FramePoses
from leap_rig.policy.network import PolicyAbout, PolicyNetwork
from leap_rig.policy.view import ACTION, FINGERS, NOTHING_M, STATE, DepthView, action_numbers, height_map, state_numbers
from leap_rig.recording import topics
from leap_rig.recording.dataset import exported_episodes
from leap_rig.recording.episode import depth_values
from leap_rig.recording.recording_files import RecordingFault, StoredMessage, between
from leap_rig.recording.run import MessageDecoders
from leap_rig.recording.signals import AGE

FPS, CHUNK = 10, 16
ARM = 7  # joints before the hand's motors in a row
LEAST = 0.01  # standard deviation by which a number is scaled
FRESH_S = 0.2  # an older measured or desired tool no longer counts


class Samples(NamedTuple):
    """Rows of episodes."""

    maps: np.ndarray  # shape (n, 52, 52)
    state: np.ndarray  # shape (n, 14)
    actions: np.ndarray  # of the next rows, seen from the tool of this one, shape (n, CHUNK, 13)
    there: np.ndarray  # which of them a hand led in the same episode without a gap, shape (n, CHUNK), bool


def samples(recording: Path, task: str = "") -> tuple[Samples, str]:
    """Returns the samples of an episode, and its task, or the one that is given; raises RecordingFault if it lacks what
    a policy sees."""
    (one,) = exported_episodes([recording], FPS, task)
    rows, names = one.signals.rows, one.signals.names
    ages = dict(zip(names[AGE], rows[AGE].T))
    known = (ages["observation.tool_pose"] >= 0.0) & (ages["observation.tool_pose"] <= FRESH_S)
    follows = rows["observation.teleoperation"][:, names["observation.teleoperation"].index("follows")] > 0.0
    age = ages["action.desired_tool"]
    led = follows & (age >= 0.0) & (age <= FRESH_S)
    T_tool, T_desired = (
        [_matrix(numbers) if good else np.eye(4) for numbers, good in zip(rows[key], there)]
        for key, there in (("observation.tool_pose", known), ("action.desired_tool", led))
    )
    fingers, commands = one.rows.state[:, ARM:], one.rows.action[:, ARM:]
    if fingers.shape[1] != FINGERS:
        raise RecordingFault(f"{recording} has {fingers.shape[1]} motors of the hand, and a policy moves {FINGERS}.")
    maps = np.array(list(_maps(recording, one.rows.times, T_tool)), np.float16)
    contacts = rows["observation.taxel_contact"]
    state = np.array([state_numbers(T, *felt) for T, *felt in zip(T_tool, fingers, contacts)])
    index, there = upcoming(led)
    there &= known[:, None]
    actions = np.zeros((*index.shape, ACTION), np.float32)
    for i in np.flatnonzero(there[:, 0]):
        # A row's command is the one of the next row, as its desired tool is.
        actions[i] = [action_numbers(T_tool[i], T_desired[k], commands[k - 1]) for k in index[i]]
    return Samples(maps, state, actions, there), one.task


def upcoming(led: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the rows of the next CHUNK actions of each row, shape (n, CHUNK), and which of them a hand led without a
    gap, bool; the others repeat the last one. `led`: whether it led a row, shape (n,)."""
    n = len(led)
    ahead = np.arange(n)[:, None] + 1 + np.arange(CHUNK)
    there = np.cumprod((ahead < n) & led[np.minimum(ahead, n - 1)], axis=1).astype(bool)
    return np.arange(n)[:, None] + np.minimum(1 + np.arange(CHUNK), np.maximum(there.sum(axis=1), 1)[:, None]), there


def _matrix(pose7: np.ndarray) -> np.ndarray:
    return pose(rotation_from_quaternion(pose7[3:]), pose7[:3])


def _maps(recording: Path, times: np.ndarray, T_tool: Sequence[np.ndarray]) -> Iterator[np.ndarray]:
    """Yields the map at each time, of the newest depth image; before the first one, of that one."""
    decode, poses, view = MessageDecoders(), FramePoses(), None
    coming_ones = between(recording, ["/tf_static", "/tf", topics.DEPTH, topics.DEPTH_INFO], 0.0, float("inf"))
    coming = next(coming_ones, None)
    newest: dict[str, StoredMessage] = {}
    points: np.ndarray | None = None
    for time, T in zip(times, T_tool):
        seen = newest.get(topics.DEPTH)
        while coming is not None and (len(newest) < 2 or 1e-9 * coming.received <= time):
            if coming.topic in (topics.DEPTH, topics.DEPTH_INFO):
                newest[coming.topic] = coming
            else:
                for each in decode(coming)["transforms"]:
                    p, q = each["transform"]["translation"], each["transform"]["rotation"]
                    numbers = *(p[i] for i in "xyz"), *(q[i] for i in "xyzw")
                    poses.put(frame_name(each["header"]["frame_id"]), frame_name(each["child_frame_id"]), numbers, 0.0)
            coming = next(coming_ones, None)
        if len(newest) < 2:
            raise RecordingFault(f"{recording} has no depth images with their camera_info; record with --camera rgbd.")
        if points is None or newest[topics.DEPTH] is not seen:
            image, info = decode(newest[topics.DEPTH]), decode(newest[topics.DEPTH_INFO])
            frame = frame_name(image["header"]["frame_id"])
            where = poses.between(BASE, frame)
            if where is None:
                raise RecordingFault(f"{recording} does not say where {frame} is, so nothing is seen from the tool.")
            try:
                camera = camera_model_from_info(_with_attributes(info), (image["width"], image["height"]))
                if view is None or not same_camera(view.camera, camera):
                    view = DepthView(camera)
                points = view.points(plausible_depth(_depth(image)), _matrix(np.array(where)))
            except ValueError as error:
                raise RecordingFault(f"The depth images of {recording} cannot be used: {error}.") from error
        yield height_map(points, T)


def _with_attributes(value: Any) -> Any:
    """Returns a decoded message as ROS has it."""
    if isinstance(value, dict):
        return SimpleNamespace(**{name: _with_attributes(part) for name, part in value.items()})
    return value


def _depth(image: dict[str, Any]) -> np.ndarray:
    depth = depth_values(image)
    return depth if depth.dtype.kind == "f" else depth * np.float32(0.001)


def trained(
    parts: Sequence[Samples], about: PolicyAbout, steps: int, seed: int, tell: Callable[[float], object]
) -> PolicyNetwork:
    """Returns the network that was trained on these episodes; `tell` takes the loss of each step."""
    size, rate = 32, 2e-3
    torch.manual_seed(seed)
    rng = np.random.default_rng(seed)
    maps, state, actions, there = (np.concatenate(column) for column in zip(*parts))
    usable = np.flatnonzero(there[:, 0])
    network = PolicyNetwork(about)
    for name, values in (("state", state[usable]), ("action", actions[there])):
        getattr(network, f"{name}_mean").copy_(torch.from_numpy(values.mean(axis=0)))
        getattr(network, f"{name}_sd").copy_(torch.from_numpy(np.maximum(values.std(axis=0), LEAST)))
    optimizer = torch.optim.AdamW(network.parameters(), lr=rate, weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, rate, total_steps=steps)
    noise = torch.tensor([0.004, *[0.02] * 6, *[0.01] * 4, *[0.02] * 3])
    for _ in range(steps):
        at = rng.choice(usable, size)
        heights = torch.from_numpy(maps[at].astype(np.float32))
        wrong = 0.003 * (torch.randn(size, 1, 1) + torch.randn_like(heights))
        heights = torch.where(heights > NOTHING_M, heights + wrong, heights)
        known = torch.from_numpy(state[at]) + noise * torch.randn(size, STATE)
        valid = torch.from_numpy(there[at])[..., None]
        wanted = (torch.from_numpy(actions[at]) - network.action_mean) / network.action_sd
        loss = ((network(heights, known) - wanted).abs() * valid).sum() / (valid.sum() * ACTION)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        tell(float(loss.detach()))
    return network.eval()
