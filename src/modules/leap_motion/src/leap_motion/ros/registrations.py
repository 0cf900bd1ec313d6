"""The stored registrations of trackers, NAME.yaml in ~/.config/leap_rig/trackers, and the one that a driver applies."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import yaml

from common.config import number, parse, text, vector
from common.errors import ConfigError, RigError
from common.poses import pose, read_only
from common.ros.files import read_yaml, user_file, write_whole
from common.rotations import quaternion_from_rotation, rotation_from_quaternion
from common.simulated import SIMULATED, simulated_field
from common.stored_time import moment, utc
from leap_motion.registration import MAX_TURN_DEG, PointFit, RegistrationRefused, check_serial, turn_deg

MAX_AGE_DAYS = 90  # a tracker on a desk gets moved


@dataclass(frozen=True, eq=False)
class TrackerRegistration:
    """The content of one file: the pose of the tracker's axes on the desk."""

    date: str = text(doc="of the measurement, in UTC as 2026-01-31T12:00:00Z")
    serial: str = text(doc="of the tracker; empty: its service does not report one", empty=True)
    position: np.ndarray = vector(3, "m", low=-2.0, high=2.0, doc="of the tracker from the points' origin")
    quaternion: np.ndarray = vector(4, doc="x, y, z, w of its orientation")
    residual_mm: float = number("mm", low=0.0, doc="largest distance of a point from where it was shown")
    simulated: bool | None = simulated_field()

    def faults(self) -> list[str]:
        faults = []
        try:
            moment(self.date)
        except ValueError:
            faults.append(f"date is {self.date!r}, but must be as 2026-01-31T12:00:00Z.")
        try:
            turn = turn_deg(pose(rotation_from_quaternion(self.quaternion)))
            if turn > MAX_TURN_DEG:
                faults.append(
                    f"quaternion turns the tracker by {turn:.0f} deg, but at most {MAX_TURN_DEG:g} are meant."
                )
        except ValueError as error:
            faults.append(f"quaternion is no rotation: {error}.")
        try:
            check_serial(self.serial)
        except RegistrationRefused as error:
            faults.append(str(error))
        return faults

    @property
    def T_desk_leap(self) -> np.ndarray:
        """The pose, shape (4, 4) [m]."""
        return read_only(pose(rotation_from_quaternion(self.quaternion), self.position))


def registration_file(name: str) -> Path:
    """Returns the path of a registration; raises RigError if the name is not one of a file."""
    return user_file("tracker", name)


def store(path: Path, found: PointFit, serial: str, now: float, simulated: bool) -> None:
    """Writes a registration of `now` [s since 1970]; raises RigError if that fails."""
    values = {
        "date": utc(now),
        "serial": serial,
        "position": found.T_desk_leap[:3, 3].round(6).tolist(),
        "quaternion": quaternion_from_rotation(found.T_desk_leap[:3, :3]).tolist(),
        "residual_mm": round(1e3 * float(found.residuals.max()), 2),
        SIMULATED: simulated,
    }
    try:
        write_whole(path, yaml.safe_dump(values, sort_keys=False))
    except OSError as error:
        raise RigError(f"{path} could not be written: {error.strerror}.") from error


def load(name: str, now: float) -> TrackerRegistration:
    """Returns the registration of that name at `now` [s since 1970]; raises RigError or ConfigError if it is missing
    or may not be used."""
    path = registration_file(name)
    again = f"Run rosrun leap_motion register_tracker.py {name}."
    try:
        values = read_yaml(path)
    except RigError as error:
        raise RigError(f"The registration {error} {again}") from error
    found = parse(TrackerRegistration, values, f"{path}: ")
    age = (now - moment(found.date)) / 86400.0
    if not -1.0 <= age <= MAX_AGE_DAYS:
        raise ConfigError([f"{path}: date is {found.date}, but must lie within the last {MAX_AGE_DAYS} days. {again}"])
    return found
