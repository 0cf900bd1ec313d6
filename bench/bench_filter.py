"""Filters of the hand: lag against the tremor that they let through, on synthetic and on recorded hands."""

from __future__ import annotations

import gzip
import time
from pathlib import Path

import numpy as np

from bench.measure import SHARED_DATA, Peer, Row
from leap_kuka import hand_filter
from leap_kuka.hand_average import HandAverage
from leap_motion.codec import read_message
from leap_motion.frames import LeapFrame, TrackedHand

FILTERS = ("mean", *hand_filter.FILTERS)
RATE_HZ = 110.0
TREMOR_HZ, TREMOR_M = (4.0, 12.0), 1e-3
BAND_HZ = 4.0  # what is faster counts as tremor in the recordings, where the true motion is unknown
NOISE_M = 3e-4  # of the tracker, independent from sample to sample
SIZE, LARGER = 10, (15, 20, 40)  # buffer_size as shipped, and larger ones
SHIFTS_S = np.arange(0.0, 0.25, 1e-3)
LEVEL = ((0.0, 0.0, -1.0), (0.0, -1.0, 0.0))


def rows(quick: bool) -> list[Row]:
    """Returns per filter its lag, the fractions of tremor and of noise that pass, and its processor time; what depends
    on the size of the buffer also for larger ones."""
    seconds, hands = 10.0 if quick else 60.0, recorded()
    where = f"{seconds:g} s of reaches of 20 cm in 0.8 s at {RATE_HZ:g} Hz, with 1 mm of tremor, 4 to 12 Hz"
    measured = {}
    for name in FILTERS:
        lag, rest, moving, cost = synthetic(name, seconds)
        values = {"lag": (1e3 * lag, "ms", where), "tremor, rest": (100.0 * rest, "%", where)}
        values.update({"noise, rest": (100.0 * noise(name, seconds), "%", "independent from sample to sample")})
        values.update({"tremor, motion": (100.0 * moving, "%", where), "one frame": (cost, "us", "processor time")})
        if hands:
            lag, passing = np.mean([on_recording(name, times, samples) for times, samples in hands], axis=0)
            real = f"mean of {len(hands)} recorded hands"
            values.update(
                {"lag, recorded": (1e3 * lag, "ms", real), "above 4 Hz, recorded": (100.0 * passing, "%", real)}
            )
        for size in LARGER:
            lag, rest, _, _ = synthetic(name, seconds, size)
            passing = 100.0 * noise(name, seconds, size)
            how = f"{size} samples"
            values.update({f"lag, {size}": (1e3 * lag, "ms", how), f"tremor, rest, {size}": (100.0 * rest, "%", how)})
            values.update({f"noise, rest, {size}": (passing, "%", how)})
        measured[name] = values
    return [
        Row(f"filter {name}: {what}", value, None, unit, how, peer=Peer("mean", measured["mean"][what][0]))
        for name, values in measured.items()
        for what, (value, unit, how) in values.items()
    ]


def filtered(name: str, times: np.ndarray, hands: list[TrackedHand], size: int = SIZE) -> np.ndarray:
    """Returns the filtered palms, shape (n, 3) [m]; those of the samples until the window is full."""
    average, palms = HandAverage(size, name), []
    for now, hand in zip(times.tolist(), hands):
        average.add(hand, now)
        mean = average.mean()
        palms.append(hand.palm if mean is None else mean.palm)
    return np.array(palms)


def synthetic(name: str, seconds: float, size: int = SIZE) -> tuple[float, float, float, float]:
    """Returns the lag [s], the fraction of tremor that passes at rest and in motion, and the time of a frame [us]."""
    random = np.random.default_rng(1)
    times = np.arange(0.0, seconds, 1.0 / RATE_HZ) + random.uniform(0.0, 0.3 / RATE_HZ, round(seconds * RATE_HZ))
    still, moves = reaches(times)
    trembling = _hands(still + tremor(times))
    smooth = filtered(name, times, _hands(still), size)
    began = time.process_time()
    palms = filtered(name, times, trembling, size)
    cost = 1e6 * (time.process_time() - began) / len(times)
    passes = np.square(palms - smooth).mean(axis=1)
    rest, moving = (float(np.sqrt(passes[(times > 1.0) & (moves == part)].mean())) / TREMOR_M for part in (0, 1))
    return best_shift(times, still, smooth), rest, moving, cost


def noise(name: str, seconds: float, size: int = SIZE) -> float:
    """Returns the fraction of the tracker's noise that passes while the hand rests."""
    times = np.arange(0.0, seconds, 1.0 / RATE_HZ)
    shaken = np.random.default_rng(3).normal(0.0, NOISE_M, (len(times), 3))
    moved = filtered(name, times, _hands(shaken), size) - sample(np.zeros(3)).palm
    return float(np.sqrt(np.square(moved[times > 1.0]).mean())) / NOISE_M


def reaches(times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Returns the palms of a hand that reaches to and fro and rests between, shape (n, 3) [m], and when it moves."""
    phase = times % 3.0
    s = np.clip((phase - 1.0) / 0.8, 0.0, 1.0) - np.clip((phase - 2.0) / 0.8, 0.0, 1.0)
    return 0.2 * np.outer(10 * s**3 - 15 * s**4 + 6 * s**5, (0.6, 0.0, 0.8)), (s > 0.0) & (s < 1.0)


def tremor(times: np.ndarray) -> np.ndarray:
    """Returns tremor, shape (n, 3) [m], of a standard deviation of TREMOR_M in each coordinate."""
    random = np.random.default_rng(2)
    hertz, phase = random.uniform(*TREMOR_HZ, (80, 3)), random.uniform(0.0, 2.0 * np.pi, (80, 3))
    waves = np.sin(2.0 * np.pi * hertz * times[:, None, None] + phase).sum(axis=1)
    return TREMOR_M * waves / waves.std(axis=0)


def best_shift(times: np.ndarray, before: np.ndarray, after: np.ndarray) -> float:
    """Returns the time [s] by which `before` must be delayed to have the velocities of `after` best."""
    velocity = np.diff(after, axis=0)

    def error(shift: float) -> float:
        delayed = np.column_stack([np.interp(times - shift, times, column) for column in before.T])
        return float(np.square(np.diff(delayed, axis=0) - velocity).sum())

    return float(min(SHIFTS_S, key=error))


def on_recording(name: str, times: np.ndarray, hands: list[TrackedHand]) -> tuple[float, float]:
    """Returns the lag [s], and the fraction of what is faster than BAND_HZ that passes."""
    palms = np.array([hand.palm for hand in hands])
    result = filtered(name, times, hands)
    grid = np.arange(times[0] + 0.2, times[-1], 1.0 / RATE_HZ)
    fast = []
    for points in (palms, result):
        even = np.column_stack([np.interp(grid, times, column) for column in points.T])
        even = (even - even.mean(axis=0)) * np.hanning(len(grid))[:, None]
        spectrum = np.fft.rfft(even, axis=0)[np.fft.rfftfreq(len(grid), 1.0 / RATE_HZ) >= BAND_HZ]
        fast.append(float(np.sqrt(np.square(np.abs(spectrum)).sum())))
    return best_shift(times, palms, result), fast[1] / fast[0]


def recorded() -> list[tuple[np.ndarray, list[TrackedHand]]]:
    """Returns the times [s] and samples of every recorded hand of more than two seconds; none without recordings."""
    found = []
    for path in sorted((SHARED_DATA / "leap").glob("*.jsonl.gz")):
        tracks: dict[int, list[tuple[float, TrackedHand]]] = {}
        for frame in _frames(path):
            for hand in frame.hands:
                sample = TrackedHand(hand.id, hand.side == "left", hand.palm, hand.direction, hand.normal, 1.0)
                tracks.setdefault(hand.id, []).append((1e-6 * frame.timestamp_us, sample))
        for track in tracks.values():
            times = np.array([seconds for seconds, _ in track])
            if times[-1] - times[0] > 2.0:
                found.append((times, [hand for _, hand in track]))
    return found


def _frames(path: Path) -> list[LeapFrame]:
    with gzip.open(path, "rt") as file:
        return [frame for frame in map(read_message, file) if isinstance(frame, LeapFrame)]


def _hands(palms: np.ndarray) -> list[TrackedHand]:
    return [sample(palm) for palm in palms]


def sample(palm: np.ndarray) -> TrackedHand:
    """Returns a level hand with its palm at a point, shape (3,) [m], from 0.3 m above the Leap."""
    direction, normal = map(np.array, LEVEL)
    return TrackedHand(1, False, palm + np.array([0.0, 0.3, 0.0]), direction, normal, 1.0)


def plot(path: Path) -> None:
    """Draws lag against tremor, and a reach with tremor as each filter has it."""
    import matplotlib.figure

    figure = matplotlib.figure.Figure(figsize=(9, 4), layout="constrained")
    left, right = figure.subplots(1, 2)
    times = np.arange(0.0, 6.0, 1.0 / RATE_HZ)
    still, _ = reaches(times)
    hands = _hands(still + tremor(times))
    shown = (times > 3.9) & (times < 5.1)
    along = np.array([0.6, 0.0, 0.8])
    right.plot(times[shown], 1e3 * np.array([h.palm for h in hands])[shown] @ along, "k:", label="samples")
    for name in FILTERS:
        lag, rest, moving, _ = synthetic(name, 30.0)
        left.plot([1e3 * lag] * 2, [rest, moving], "o-", label=name)
        left.annotate("in motion", (1e3 * lag, moving), textcoords="offset points", xytext=(6, 0), fontsize=8)
        right.plot(times[shown], 1e3 * filtered(name, times, hands)[shown] @ along, label=name)
    left.set(xlabel="lag [ms]", ylabel="fraction of tremor that passes", xlim=(-2, 55), ylim=(0, 1))
    right.set(xlabel="time [s]", ylabel="palm along the reach [mm]")
    left.legend()
    right.legend()
    figure.savefig(path, dpi=110)
