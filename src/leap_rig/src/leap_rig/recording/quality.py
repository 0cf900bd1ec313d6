"""What a recorded episode is worth for training: measures of it, and by name what would spoil a training.

    unreadable, no-rows   the recording, or what is learned from, is missing
    time-back             a clock was set back
    nan                   a number is not finite
    no-label              nobody and nothing said success or failure
    too-short             shorter than the limit
    frozen-joints         a joint is measured at one angle while its goal moves
    stalled, limited, tracking-lost   for more than a fraction of the time
    empty-camera, frozen-camera, missing-images
    other-signals, mixed-rates   the episode differs from the others
    no-success            no episode succeeded

What else differs from the other episodes is for a person to judge: outliers."""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np

from common.episode_marks import FAILURE, SUCCESS
from common.errors import RigError
from common.hand_delay import Track, hand_delay
from leap_rig.recording import topics
from leap_rig.recording.dataset import camera_name, first_images, images
from leap_rig.recording.episode import IMAGE, TrainingEpisode, training_episode
from leap_rig.recording.leader import read_leader
from leap_rig.recording.recording_files import MESSAGES, between, messages
from leap_rig.recording.run import MessageDecoders, RecordedRun, read
from leap_rig.recording.session import FOLDER, LABEL, EpisodeLabel, read_label
from leap_rig.recording.signals import AGE, SignalTable, read_signals

OBJECTS = "/simulation/object_states"
HEAD = struct.Struct("<III")  # of a message with a header: number, seconds, nanoseconds
BACK_NS = 50_000_000  # between two messages: time that goes back farther was set
GRID_S = 0.02
TOOL, TRACKER, CONTROLLER = "observation.tool_pose", "observation.tracker", "observation.controller"
SAMPLES = 24  # images by which a camera is judged
FILM_S, MOST_IMAGES = 0.25, 120  # between two images of a film; a longer film has them farther apart


@dataclass(frozen=True)
class QualityLimits:
    """Beyond which an episode is refused."""

    shortest: float = field(default=1.0, metadata={"is": "s an episode lasts at least", "to": 3600.0})
    frozen: float = field(default=0.5, metadata={"is": "s a joint may stay while its goal moves", "to": 60.0})
    stalled: float = field(default=0.5, metadata={"is": "fraction of the time without motion", "to": 1.0})
    limited: float = field(default=0.5, metadata={"is": "fraction of the time at a limit", "to": 1.0})
    lost: float = field(default=0.3, metadata={"is": "fraction of the time without a tracked hand", "to": 1.0})
    missing: float = field(default=0.2, metadata={"is": "fraction of a camera's images that is missing", "to": 1.0})
    contrast: float = field(default=2.0, metadata={"is": "least standard deviation of an image, of 255", "to": 255.0})
    rates: float = field(default=0.25, metadata={"is": "deviation of a rate from the other episodes'", "to": 10.0})


class QualityFault(NamedTuple):
    """Why an episode is refused."""

    name: str
    why: str  # a clause


@dataclass(frozen=True)
class CameraQuality:
    """The images of one camera."""

    count: int
    rate: float  # [1/s]
    missing: float  # fraction
    sharpness: float  # median variance of the Laplacian; NaN of depth
    contrast: float  # median standard deviation, of 255
    distinct: int
    topic: str
    span: tuple[float, float]  # first and last row, since the epoch [s]


@dataclass
class EpisodeQuality:
    """What is known of an episode; measures that are not known are missing."""

    name: str
    label: EpisodeLabel = field(default_factory=EpisodeLabel)
    measures: dict[str, float] = field(default_factory=dict)
    cameras: dict[str, CameraQuality] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)  # [1/s]
    starts: dict[str, tuple[float, ...]] = field(default_factory=dict)  # tool, and objects: where they are [m]
    speed: np.ndarray = field(default_factory=lambda: np.zeros(0))  # of the tool each GRID_S [m/s]
    faults: list[QualityFault] = field(default_factory=list)
    outliers: list[str] = field(default_factory=list)  # measures that are far from the other episodes'

    def refuse(self, name: str, why: str) -> None:
        self.faults.append(QualityFault(name, why))


MEASURES = {
    "duration": "s",
    "path": "m",
    "jerk": "m/s³, root mean square of the tool's",
    "stalls": "pauses of 0.5 s and more",
    "stalled": "% of the time without motion",
    "limited": "% of the time at a limit of the hand or the arm",
    "guarded": "% of the time slowed by the collision guard",
    "lost": "% of the time without a tracked hand",
    "delay": "ms from the hand to the arm",
    "dropped": "messages that the disk did not take",
    "missing": "% of the images of the worst camera",
    "sharpness": "variance of the Laplacian, blurriest camera",
}
FRACTIONS = {"stalled": "stalled", "limited": "limited", "lost": "tracking-lost"}


def episode_quality(folder: Path, fps: int, limits: QualityLimits) -> EpisodeQuality:
    """Returns what a recording is worth; what cannot be read is a fault of it."""
    found = EpisodeQuality(f"{folder.parent.name}/{folder.name}" if FOLDER.fullmatch(folder.name) else folder.name)
    try:
        if (folder / LABEL).exists():
            found.label = read_label(folder)
        run = read(folder)
    except RigError as error:
        found.refuse("unreadable", str(error))
        return found
    if found.label.outcome not in (SUCCESS, FAILURE):
        found.refuse("no-label", "nothing says whether it succeeded")
    _receipts(folder, found)
    if any(fault.name == "time-back" for fault in found.faults):
        return found
    try:
        rows = training_episode(run, fps)
        signals = read_signals(folder, rows.times, run)
        _judge_cameras(folder, rows.times, found, limits)
        found.starts.update(_objects(folder))
    except RigError as error:
        found.refuse("time-back" if "set back" in str(error) else "no-rows", str(error))
        return found
    found.measures["dropped"] = float(sum(run.manifest.get("dropped", {}).values()))
    judge_rows(rows, signals, ~read_leader(folder, rows.times)[0], fps, limits, found)
    judge_motion(run, rows, fps, found)
    for measure, name in FRACTIONS.items():
        if found.measures.get(measure, 0.0) > 100.0 * getattr(limits, measure):
            found.refuse(name, f"{found.measures[measure]:.0f} {MEASURES[measure]}")
    return found


def judge_rows(
    rows: TrainingEpisode,
    signals: SignalTable,
    by_hand: np.ndarray,
    fps: int,
    limits: QualityLimits,
    found: EpisodeQuality,
) -> None:
    """Adds what the rows say: their numbers, frozen joints, limits, and lost hands where no policy leads, `by_hand`."""
    duration = len(rows.times) / fps
    found.measures["duration"] = duration
    if duration < limits.shortest:
        found.refuse("too-short", f"it lasts {duration:.2f} s")
    for key, values in (("observation.state", rows.state), ("action", rows.action), *signals.rows.items()):
        bad = int((~np.isfinite(values)).any(axis=1).sum())
        if bad:
            found.refuse("nan", f"{bad} of {len(values)} rows of {key} are not finite")
    for joint, since in frozen_joints(rows, fps, limits.frozen):
        found.refuse("frozen-joints", f"{joint} stays at {since:.1f} s while its goal moves")
    hand_limited = signals.rows["observation.teleoperation"][:, 3] > 0.0
    limited = hand_limited | (signals.rows[CONTROLLER][:, 3] > 0.0)
    guard = signals.rows["observation.guard"]
    found.measures["limited"] = 100.0 * float(limited.mean())
    found.measures["guarded"] = 100.0 * float(((guard[:, 0] > 0.0) & (guard[:, 2] < 1.0)).mean())
    age = signals.rows[AGE][:, signals.names[AGE].index(topics.RAW_FRAMES.strip("/").replace("/", "."))]
    lost = lost_fraction(signals.rows[TRACKER][by_hand, 0], age[by_hand])
    if lost is not None:
        found.measures["lost"] = 100.0 * lost


def frozen_joints(rows: TrainingEpisode, fps: int, longest_s: float) -> list[tuple[str, float]]:
    """Returns the arm's joints that are measured at one angle for so long while their action moves, and when that
    begins [s]."""
    still_rad, moves_rad = 1e-5, 0.02
    length = max(2, math.ceil(longest_s * fps) + 1)
    if len(rows.times) < length:
        return []
    state = np.lib.stride_tricks.sliding_window_view(rows.state[:, :7], length, axis=0)
    action = np.lib.stride_tricks.sliding_window_view(rows.action[:, :7], length, axis=0)
    frozen = (np.ptp(state, axis=2) < still_rad) & (np.ptp(action, axis=2) > moves_rad)
    return [(rows.names[i], int(np.argmax(frozen[:, i])) / fps) for i in range(7) if frozen[:, i].any()]


def lost_fraction(hands: np.ndarray, age: np.ndarray) -> float | None:
    """Returns for which fraction of the rows between the first and the last hand there was none; None: never a hand.
    `age` [s], negative before the first frame."""
    silent_s = 0.2
    seen = (hands > 0.0) & (age >= 0.0) & (age <= silent_s)
    at = np.flatnonzero(seen)
    return None if not len(at) else 1.0 - float(seen[at[0] : at[-1] + 1].mean())


def judge_motion(run: RecordedRun, rows: TrainingEpisode, fps: int, found: EpisodeQuality) -> None:
    """Adds how the tool moves, and how long after the hand."""
    times, unique = np.unique(run.tool_times, return_index=True)
    tool = run.tool[unique, :3, 3]
    if len(times) > 1:
        grid = np.arange(rows.times[0], rows.times[-1], GRID_S)
        track = np.column_stack([np.interp(grid, times, axis) for axis in tool.T])
        found.starts["tool"] = tuple(track[0].tolist()) if len(track) else ()
        found.speed = np.linalg.norm(np.diff(track, axis=0), axis=1) / GRID_S
        found.measures["path"] = float(found.speed.sum() * GRID_S)
        if (jerk := rms_jerk(track)) is not None:
            found.measures["jerk"] = jerk
    count, stalled_s = stalls(rows, fps)
    found.measures["stalls"], found.measures["stalled"] = float(count), 100.0 * stalled_s * fps / len(rows.times)
    palm, tip = palm_track(run), Track()
    for time, position in zip(run.tool_times.tolist(), run.tool[:, :3, 3].tolist()):
        tip.add(time, position)
    delay = hand_delay(palm, tip)
    if delay is not None:
        found.measures["delay"] = 1e3 * delay.median


def rms_jerk(track: np.ndarray) -> float | None:
    """Returns the root mean square jerk [m/s³] of positions each GRID_S, shape (n, 3) [m], smoothed over 0.1 s."""
    width = 5
    if len(track) < 4 * width:
        return None
    window = np.ones(width) / width
    smooth = np.column_stack([np.convolve(np.convolve(a, window, "valid"), window, "valid") for a in track.T])
    jerk = np.diff(smooth, 3, axis=0) / GRID_S**3
    return float(np.sqrt(np.square(jerk).sum(axis=1).mean()))


def stalls(rows: TrainingEpisode, fps: int) -> tuple[int, float]:
    """Returns how often nothing moves for half a second and more between the first and the last motion, or at all, and
    how long in sum [s]."""
    still_rad_s, least_s = 0.01, 0.5
    still = (np.abs(np.diff(rows.state, axis=0)) * fps < still_rad_s).all(axis=1)
    moved = np.flatnonzero(~still)
    still = still[moved[0] : moved[-1]] if len(moved) else still
    edges = np.flatnonzero(np.diff(np.r_[0, still.astype(int), 0]))
    lengths = (edges[1::2] - edges[::2]) / fps
    long = lengths[lengths >= least_s]
    return len(long), float(long.sum())


def palm_track(run: RecordedRun) -> Track:
    """Returns where the palm is that is seen most often [m], by the times of receipt."""
    seen: dict[Any, list[tuple[float, list[float]]]] = {}
    for time, text in zip(run.frame_times.tolist(), run.frames):
        try:
            for hand in json.loads(text).get("hands", []):
                position = [1e-3 * float(value) for value in hand["palmPosition"]]
                if len(position) == 3:
                    seen.setdefault(str(hand.get("id")), []).append((time, position))
        except (AttributeError, KeyError, TypeError, ValueError):
            continue  # no frame
    track = Track()
    for time, position in max(seen.values(), key=len, default=[]):
        track.add(time, position)
    return track


def compare(episodes: Sequence[EpisodeQuality], limits: QualityLimits) -> tuple[list[QualityFault], list[str]]:
    """Adds to each episode what differs from the others. Returns the faults of all together, and remarks, sentences."""
    whole = [one for one in episodes if one.rates]
    for key in sorted({key for one in whole for key in one.rates}):
        rates = [one.rates[key] for one in whole if key in one.rates]
        middle = float(np.median(rates))
        with_it = sum(key in one.rates for one in whole)
        for one in whole:
            if key not in one.rates and 2 * with_it > len(whole):
                one.refuse("other-signals", f"{key} is missing, which {with_it} of {len(whole)} episodes have")
            elif key in one.rates and 2 * with_it <= len(whole):
                one.refuse("other-signals", f"{key} is in {with_it} of {len(whole)} episodes only")
            elif key in one.rates and abs(one.rates[key] - middle) > limits.rates * middle:
                one.refuse("mixed-rates", f"{key} came {one.rates[key]:.1f} times a second, elsewhere {middle:.1f}")
    for measure in MEASURES:
        for one in _outliers(measure, episodes):
            one.outliers.append(measure)
    return _of_all(episodes)


def _of_all(episodes: Sequence[EpisodeQuality]) -> tuple[list[QualityFault], list[str]]:
    alike_m = 0.001
    faults, remarks = [], []
    if not any(one.label.outcome == SUCCESS for one in episodes):
        faults.append(QualityFault("no-success", "no episode is a success, so there is nothing to imitate"))
    starts = spread_of_starts(episodes)
    if len(episodes) > 2 and starts and max(starts.values()) < alike_m:
        remarks.append("All episodes begin with tool and objects at one place: a policy learns that path by heart.")
    if not any(one.cameras for one in episodes):
        remarks.append("There are no images, so a policy does not see where an object is.")
    return faults, remarks


def spread_of_starts(episodes: Sequence[EpisodeQuality]) -> dict[str, float]:
    """Returns how far the tool and each object begin from their mean place, root mean square [m]."""
    found = {}
    for name in sorted({name for one in episodes for name in one.starts}):
        at = np.array([one.starts[name] for one in episodes if one.starts.get(name)])
        if len(at) > 1:
            found[name] = float(np.sqrt(np.square(at - at.mean(axis=0)).sum(axis=1).mean()))
    return found


def _outliers(measure: str, episodes: Sequence[EpisodeQuality]) -> list[EpisodeQuality]:
    """Returns the episodes beyond 3.5 scaled median deviations (Iglewicz and Hoaglin 1993), of five at least."""
    fewest, most, scale = 5, 3.5, 0.6745
    with_it = [one for one in episodes if measure in one.measures]
    values = np.array([one.measures[measure] for one in with_it])
    if len(values) < fewest:
        return []
    off = np.abs(values - np.median(values))
    middle = max(float(np.median(off)), 0.01 * float(np.abs(np.median(values))), 1e-6)
    return [one for one, far in zip(with_it, scale * off / middle > most) if far]


def _receipts(folder: Path, found: EpisodeQuality) -> None:
    """Adds rates, and cameras with their counts; refuses a clock that was set back."""
    last = 0
    received: dict[str, list[int]] = {}
    for message in messages(folder / MESSAGES):
        if message.received < last - BACK_NS:
            found.refuse("time-back", f"{message.topic} came {1e-9 * (last - message.received):.2f} s before the last")
            return
        last = message.received
        if message.topic in (topics.JOINTS, topics.RAW_FRAMES) or message.kind.name == IMAGE:
            received.setdefault(message.topic, []).append(last)
    for topic, times in received.items():
        if len(times) > 1 and times[-1] > times[0]:
            found.rates[topic] = 1e9 * (len(times) - 1) / (times[-1] - times[0])


def _judge_cameras(folder: Path, times: np.ndarray, found: EpisodeQuality, limits: QualityLimits) -> None:
    first_images(folder)  # refuses a size that changes
    stamps: dict[str, list[int]] = {}
    sums: dict[str, set[int]] = {}
    for message in between(folder, None, 0.0, math.inf):
        if message.kind.name == IMAGE:
            _, seconds, nanoseconds = HEAD.unpack_from(message.data)
            stamps.setdefault(message.topic, []).append(10**9 * seconds + nanoseconds)
            sums.setdefault(message.topic, set()).add(zlib.crc32(message.data[HEAD.size :]))
    for topic, of in stamps.items():
        key = camera_name(topic)
        camera = camera_quality(folder, topic, times, np.array(of), len(sums[topic]))
        found.cameras[key] = camera
        if (np.diff(of) < -BACK_NS).any():
            found.refuse("time-back", f"the stamps of {key} go back")
        if camera.contrast < limits.contrast:
            found.refuse("empty-camera", f"{key} shows one colour: its standard deviation is {camera.contrast:.1f}")
        elif camera.count > 1 and camera.distinct == 1:
            found.refuse("frozen-camera", f"all {camera.count} images of {key} are the same")
        if camera.missing > limits.missing:
            found.refuse("missing-images", f"{100.0 * camera.missing:.0f} % of the images of {key} are missing")
    if found.cameras:
        found.measures["missing"] = 100.0 * max(one.missing for one in found.cameras.values())
        sharp = [one.sharpness for one in found.cameras.values() if math.isfinite(one.sharpness)]
        if sharp:
            found.measures["sharpness"] = min(sharp)


def camera_quality(folder: Path, topic: str, times: np.ndarray, stamps: np.ndarray, distinct: int) -> CameraQuality:
    """Returns what the images of a topic are worth at the rows' times [s]; `stamps` of all images [ns]."""
    sharp, contrast = [], []
    for image in images(folder, topic, _sampled(times, SAMPLES)):
        grey = image.max(axis=2) if topic == topics.DEPTH else cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
        contrast.append(float(grey.std()))
        if topic != topics.DEPTH:
            sharp.append(float(cv2.Laplacian(grey, cv2.CV_64F).var()))
    return CameraQuality(
        len(stamps), *_rate_and_missing(stamps), float(np.median(sharp)) if sharp else math.nan,
        float(np.median(contrast)) if contrast else 0.0, distinct, topic, (times[0], times[-1]),
    )  # fmt: skip


def film(folder: Path, camera: CameraQuality) -> list[bytes]:
    """Returns a recording's images of a camera, small, as JPEG; RecordingFault: as `images`."""
    width, (begin, end) = 160, camera.span
    drawn = []
    for image in images(folder, camera.topic, _sampled(np.arange(begin, end, FILM_S), MOST_IMAGES)):
        size = (width, max(1, round(width * image.shape[0] / image.shape[1])))
        shown = cv2.resize(cv2.cvtColor(image, cv2.COLOR_RGB2BGR), size, interpolation=cv2.INTER_AREA)
        drawn.append(cv2.imencode(".jpg", shown)[1].tobytes())
    return drawn


def _sampled(times: np.ndarray, most: int) -> np.ndarray:
    """Returns at most so many of the times, evenly spaced."""
    return times[np.unique(np.linspace(0, len(times) - 1, min(most, len(times))).round().astype(int))]


def _rate_and_missing(stamps: np.ndarray) -> tuple[float, float]:
    """Returns how often images come [1/s], and which fraction of them is missing, by their median distance."""
    steps = 1e-9 * np.diff(np.sort(stamps))
    steps = steps[steps > 0.0]
    if not len(steps):
        return 0.0, 0.0
    period = float(np.median(steps))
    expected = 1 + int(np.maximum(np.round(steps / period), 1).sum())
    return 1.0 / period, 1.0 - (len(steps) + 1) / expected


def _objects(folder: Path) -> Mapping[str, tuple[float, ...]]:
    """Returns where the objects of the simulated world are at the start [m]; nothing of a real one."""
    decode = MessageDecoders()
    for message in between(folder, [OBJECTS], 0.0, math.inf):
        try:
            at = {str(one["name"]): one["pose"]["position"] for one in decode(message)["objects"]}
            return {name: tuple(float(place[axis]) for axis in "xyz") for name, place in at.items()}
        except (KeyError, TypeError, ValueError):
            return {}
    return {}
