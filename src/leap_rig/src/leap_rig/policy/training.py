"""Training of a policy on recorded episodes, without ROS."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch

from common.camera_model import CameraModel, distortion
from common.frames import BASE, frame_name
from common.poses import pose
from common.rotations import rotation_from_quaternion
from leap_rig.cockpit.frame_poses import FramePoses
from leap_rig.policy.network import PolicyAbout, PolicyNetwork
from leap_rig.policy.view import ACTION, FINGERS, NOTHING_M, STATE, DepthView, action_numbers, height_map, state_numbers
from leap_rig.recording import topics
from leap_rig.recording.dataset import exported_episodes
from leap_rig.recording.episode import depth_values
from leap_rig.recording.recording_files import RecordingFault, between
from leap_rig.recording.run import MessageDecoders
from leap_rig.recording.signals import AGE

FPS, CHUNK = 10, 16
ARM = 7  # joints before the hand's motors in a row
LEAST = 0.01  # standard deviation by which a number is scaled
FRESH_S = 0.2  # an older desired tool no longer counts
INFO = "/camera/depth/camera_info"


class Samples(NamedTuple):
    """Rows of episodes."""

    maps: np.ndarray  # shape (n, 52, 52)
    state: np.ndarray  # shape (n, 14)
    actions: np.ndarray  # of the next rows, seen from the tool of this one, shape (n, CHUNK, 13)
    there: np.ndarray  # which of them a hand led in the same episode without a gap, shape (n, CHUNK), bool


def samples(recording: Path) -> tuple[Samples, str]:
    """Returns the samples of an episode, and its task; raises RecordingFault if it lacks what a policy sees."""
    (one,) = exported_episodes([recording], FPS, "")
    rows, names = one.signals.rows, one.signals.names
    ages = dict(zip(names[AGE], rows[AGE].T))
    known = ages["observation.tool_pose"] >= 0.0
    follows = rows["observation.teleoperation"][:, names["observation.teleoperation"].index("follows")] > 0.0
    age = ages["action.desired_tool"]
    led = known & follows & (age >= 0.0) & (age <= FRESH_S)
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
    """Yields the map at each time, of the newest depth image."""
    decode, poses, view, camera = MessageDecoders(), FramePoses(), None, ""
    points: np.ndarray | None = None
    coming_ones = between(recording, ["/tf_static", "/tf", topics.DEPTH, INFO], 0.0, float("inf"))
    coming = next(coming_ones, None)
    image: dict[str, Any] | None = None
    for time, T in zip(times, T_tool):
        new = False
        while coming is not None and ((points is None and image is None) or 1e-9 * coming.received <= time):
            if coming.topic == topics.DEPTH:
                image, new = decode(coming), view is not None
            elif coming.topic == INFO:
                if view is None:
                    view, new = DepthView(_camera(decode(coming))), image is not None
            else:
                for each in decode(coming)["transforms"]:
                    p, q = each["transform"]["translation"], each["transform"]["rotation"]
                    numbers = *(p[i] for i in "xyz"), *(q[i] for i in "xyzw")
                    poses.put(frame_name(each["header"]["frame_id"]), frame_name(each["child_frame_id"]), numbers, 0.0)
            coming = next(coming_ones, None)
        if new and image is not None and view is not None:
            camera = frame_name(image["header"]["frame_id"])
            chain = poses.chain(camera)
            if chain is None or chain[0] != BASE:
                raise RecordingFault(f"{recording} does not say where {camera} is, so nothing is seen from the tool.")
            points = view.points(_depth(image), _matrix(np.array(chain[1])))
        if points is None:
            raise RecordingFault(f"{recording} has no depth images with their camera_info; record with --camera rgbd.")
        yield height_map(points, T)


def _camera(info: dict[str, Any]) -> CameraModel:
    K, R, P = (np.reshape(info[name], shape) for name, shape in (("K", (3, 3)), ("R", (3, 3)), ("P", (3, 4))))
    return CameraModel("depth", info["width"], info["height"], K, distortion(info["distortion_model"], info["D"]), R, P)


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
