"""Filters of palm, direction and normal of one hand against tremor and noise; nine numbers in the Leap frame, palm in
m. `OneEuro` is a low-pass whose cutoff rises with the speed (Casiez, Roussel, Vogel, 1 Euro Filter, CHI 2012). `Kalman`
models the tremor beside the motion, so it hardly delays the motion (docs/handbook/hand-filter.md)."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from common.hand_tracking import MAX_SPEED_M_S

PALM, ORIENTATION = slice(0, 3), slice(3, 9)  # in a sample

MIN_CUTOFF_HZ = 1.5  # of One-Euro, at rest
CUTOFF_PER_SPEED = (40.0, 0.5)  # rise of the cutoff with the speed of palm [Hz per m/s] and orientation [Hz per 1/s]
SPEED_CUTOFF_HZ = 1.0  # of these speeds

TREMOR_HZ, TREMOR_DAMPING = 8.5, 0.15  # middle of the band of tremor, 4 to 12 Hz, and its relative width
TREMOR_RAD_S = 2.0 * math.pi * TREMOR_HZ
DAMPED_RAD_S = TREMOR_RAD_S * math.sqrt(1.0 - TREMOR_DAMPING**2)


@dataclass(frozen=True)
class Motion:
    """What a Kalman filter takes the voluntary motion and the samples to be, where the variance of tremor is 1."""

    jerk: float  # spectral density of the motion's jerk [1/s^5]
    sample_variance: float  # of the error of a sample
    farthest: float
    """Largest distance of the result from the nearer one of the newest two samples; tremor stays below it. It bounds
    how far the tool overshoots when a hand stops; at 74 Hz and more, a single glitch moves the result no farther."""
    fastest: float  # largest speed of the result [1/s]; it limits the steps that the tracker's glitches make


PALM_MOTION = Motion(jerk=6e4, sample_variance=0.4**2, farthest=0.007, fastest=MAX_SPEED_M_S)
"""For a tremor of 1 mm the jerk is 0.06 m^2/s^5: the acceleration changes by 0.24 m/s^2 in a second, at random."""
ORIENTATION_MOTION = Motion(jerk=1e5, sample_variance=2.0**2, farthest=0.5, fastest=4.0)
"""Noisier: while a hand rolls, the tracker's orientation jumps by up to 9 deg from one frame to the next. No joint of
the arm is much faster than this."""


class OneEuro:
    """Low-pass of first order whose cutoff rises with the speed, of palm and orientation separately."""

    def __init__(self) -> None:
        self._time: float | None = None
        self._before: Sequence[float] = ()
        self._values: list[float] = []
        self._speeds: list[float] = []

    def reset(self) -> None:
        self._time = None

    def step(self, sample: Sequence[float], now: float) -> Sequence[float]:
        """Returns the filtered sample; `sample` was taken at `now` [s], not before the one before."""
        if self._time is None:
            self._values, self._speeds = list(sample), [0.0] * len(sample)
        elif now > self._time:
            dt = now - self._time
            speed_weight = _weight(SPEED_CUTOFF_HZ, dt)
            for part, rise in zip((PALM, ORIENTATION), CUTOFF_PER_SPEED):
                steps = [x - before for x, before in zip(sample[part], self._before[part])]
                speeds = [v + speed_weight * (step / dt - v) for v, step in zip(self._speeds[part], steps)]
                weight = _weight(MIN_CUTOFF_HZ + rise * math.hypot(*speeds), dt)
                self._speeds[part] = speeds
                self._values[part] = [y + weight * (x - y) for x, y in zip(sample[part], self._values[part])]
        self._time, self._before = now, sample
        return self._values


def _weight(cutoff: float, dt: float) -> float:
    """Returns the weight of a new value in a low-pass of `cutoff` [Hz], `dt` [s] after the value before."""
    return 1.0 - math.exp(-2.0 * math.pi * cutoff * dt)


class Kalman:
    """Kalman filters of palm and orientation, whose motions differ."""

    def __init__(self) -> None:
        self._parts = (PALM, MotionKalman(PALM_MOTION)), (ORIENTATION, MotionKalman(ORIENTATION_MOTION))

    def reset(self) -> None:
        for _, part in self._parts:
            part.reset()

    def step(self, sample: Sequence[float], now: float) -> Sequence[float]:
        """Returns the filtered sample; `sample` was taken at `now` [s], not before the one before."""
        return [number for numbers, part in self._parts for number in part.step(sample[numbers], now)]


class MotionKalman:
    """Kalman filter of a motion with random jerk plus a tremor, a damped oscillation with random excitation. The
    state of each number is the motion's value p, speed v and acceleration a, and the tremor u with its quadrature w;
    p + u is observed. The covariance (pp, pv, ... ww) is the same for all numbers, in variances of u."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self._time: float | None = None
        self._values: list[float] = []
        self._before: Sequence[float] = ()
        self._states: list[tuple[float, float, float, float, float]] = []
        self._covariance: tuple[float, ...] = ()

    def reset(self) -> None:
        self._time = None

    def step(self, sample: Sequence[float], now: float) -> list[float]:
        """Returns the filtered numbers; `sample` was taken at `now` [s], not before the one before."""
        if self._time is None:
            self._states = [(number, 0.0, 0.0, 0.0, 0.0) for number in sample]
            motion = (1.0, 0.0, 0.0, 1e2, 0.0, 1e4)  # pp, pv, pa, vv, va, aa
            self._covariance = (*motion, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0)
            self._values, self._before = list(sample), sample
        else:
            dt = now - self._time
            self._update(sample, dt)
            values = [state[0] for state in self._states]
            nearer = min(sample, self._before, key=lambda other: math.dist(values, other))
            values = _within(nearer, values, self._motion.farthest)
            self._values, self._before = _within(self._values, values, self._motion.fastest * dt), sample
        self._time = now
        return self._values

    def _update(self, sample: Sequence[float], dt: float) -> None:
        half, jerk = 0.5 * dt * dt, self._motion.jerk
        decay = math.exp(-TREMOR_DAMPING * TREMOR_RAD_S * dt)
        sine = decay * math.sin(DAMPED_RAD_S * dt) * TREMOR_RAD_S / DAMPED_RAD_S
        cosine = decay * math.cos(DAMPED_RAD_S * dt)
        f, g = cosine + TREMOR_DAMPING * sine, cosine - TREMOR_DAMPING * sine  # u = f u + sine w, w = g w - sine u
        pp, pv, pa, vv, va, aa, pu, pw, vu, vw, au, aw, uu, uw, ww = self._covariance

        pa_before, va_before = pa, va
        va += dt * aa
        pa += dt * va_before + half * aa
        pp += dt * pv + half * pa_before + dt * (pv + dt * vv + half * va_before) + half * pa + jerk * dt**5 / 20.0
        pv += dt * pa_before + dt * (vv + dt * va_before) + half * va + jerk * dt**4 / 8.0
        vv += dt * (va_before + va) + jerk * dt**3 / 3.0
        pa, va, aa = pa + jerk * dt**3 / 6.0, va + jerk * half, aa + jerk * dt
        pu, pw, vu, vw = pu + dt * vu + half * au, pw + dt * vw + half * aw, vu + dt * au, vw + dt * aw
        pu, pw, vu, vw = f * pu + sine * pw, g * pw - sine * pu, f * vu + sine * vw, g * vw - sine * vu
        au, aw = f * au + sine * aw, g * aw - sine * au
        uu, uw, ww = uu - 1.0, uw, ww - 1.0  # what differs from the tremor's own covariance, the identity, decays
        uu, uw, ww = (
            1.0 + f * f * uu + 2.0 * f * sine * uw + sine * sine * ww,
            f * g * uw - f * sine * uu + sine * g * ww - sine * sine * uw,
            1.0 + sine * sine * uu - 2.0 * sine * g * uw + g * g * ww,
        )

        sp, sv, sa, su, sw = pp + pu, pv + vu, pa + au, pu + uu, pw + uw
        scale = 1.0 / (sp + su + self._motion.sample_variance)
        kp, kv, ka, ku, kw = scale * sp, scale * sv, scale * sa, scale * su, scale * sw
        self._covariance = (
            pp - kp * sp, pv - kp * sv, pa - kp * sa, vv - kv * sv, va - kv * sa, aa - ka * sa,
            pu - kp * su, pw - kp * sw, vu - kv * su, vw - kv * sw, au - ka * su, aw - ka * sw,
            uu - ku * su, uw - ku * sw, ww - kw * sw,
        )  # fmt: skip
        states = []
        for number, (p, v, a, u, w) in zip(sample, self._states):
            p, v, u, w = p + dt * v + half * a, v + dt * a, f * u + sine * w, g * w - sine * u
            error = number - p - u
            states.append((p + kp * error, v + kv * error, a + ka * error, u + ku * error, w + kw * error))
        self._states = states


def _within(centre: Sequence[float], values: list[float], farthest: float) -> list[float]:
    """Returns the numbers nearest to `values` whose distance from `centre` is `farthest` at most."""
    distance = math.dist(centre, values)
    if distance <= farthest:
        return values
    return [x + farthest / distance * (y - x) for x, y in zip(centre, values)]


FILTERS: dict[str, type[OneEuro] | type[Kalman]] = {"one_euro": OneEuro, "kalman": Kalman}
