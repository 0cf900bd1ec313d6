"""The program register_tracker: measures where a tracker stands and stores that under a name."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from common import clock
from common.config import parse_part, vector
from common.errors import ConfigError, RigError
from common.ros.files import read_yaml
from common.ros.service_calls import MasterLost, ask_master
from leap_motion.client import LeapClient, LeapLink
from leap_motion.frames import LeapFrame
from leap_motion.registration import (
    HOLD_S,
    PointFit,
    RegistrationRefused,
    check_fit,
    check_points,
    check_serial,
    fit,
    fit_level,
    sheet_points,
    still_tip,
    tilt_deg,
)
from leap_motion.ros.registrations import registration_file, store

NAME = "register_tracker"
INTERRUPTED = 130


@dataclass(frozen=True)
class _Point:
    at: np.ndarray = vector(3, "m", low=-2.0, high=2.0)


def main(arguments: list[str] | None = None, ask: Callable[[str], str] = input) -> int:
    """Runs the program; returns the exit code: 0 stored, 1 refused, 130 interrupted."""
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description="Measures where a tracker stands on the desk.")
    add = parser.add_argument
    add("name", help="of the registration: letters, digits, - and _; later registration:=NAME")
    add("--level", action="store_true", help="only the tilt: touch points of equal height anywhere")
    add("--height", type=float, default=200.0, metavar="MM", help="of what stands on the marks of the sheet, 200 mm")
    add("--points", type=Path, metavar="FILE", help="yaml file of other points, name: [x, y, z] in m; y is up")
    add("--limit", type=float, default=8.0, metavar="MM", help="largest residual of a point, 8 mm")
    add("--scale-limit", type=float, default=2.5, metavar="PERCENT", help="largest error of the distances, 2.5 %%")
    add("--host", default="127.0.0.1", help="address of the Leap service")
    add("--port", type=int, default=6437, help="its WebSocket port")
    add("--code", default="", help="code that a service on another machine asks for")
    add("--fingerprint", default="", help="of that service's certificate")
    add("--trust-network", action="store_true", help="take hands from another machine without proof or encryption")
    add("--force", action="store_true", help="replace an earlier registration without a question")
    options = parser.parse_args(arguments)
    try:
        _run(options, ask)
    except (RigError, RegistrationRefused) as error:
        for sentence in error.faults if isinstance(error, ConfigError) else [str(error)]:
            print(f"{NAME}: {sentence}", file=sys.stderr)
        print("Nothing was stored.", file=sys.stderr)
        return 1
    except (KeyboardInterrupt, EOFError):
        print("\nInterrupted; nothing was stored.")
        return INTERRUPTED
    return 0


def _run(options: argparse.Namespace, ask: Callable[[str], str]) -> None:
    lowest_mm = 20.0  # of what stands on the marks; an error in it shows in no residual
    highest_mm = 600.0
    if not lowest_mm <= options.height <= highest_mm:
        raise RegistrationRefused(
            f"--height is {options.height:g} mm, but must be between {lowest_mm:g} and {highest_mm:g} mm."
        )
    path = registration_file(options.name)
    points = _points(options.points) if options.points else sheet_points(1e-3 * options.height)
    check_points(points)
    _refuse_running_driver()
    if path.exists() and not options.force and ask(f"{path} exists. Replace it? [y/N] ").strip().lower() != "y":
        raise RigError("Cancelled.")
    proof = {"code": options.code, "fingerprint": options.fingerprint, "trust_network": options.trust_network}
    try:
        client = LeapClient(options.host, options.port, **proof, runtime=clock)
    except ValueError as error:
        raise RigError(str(error)) from error
    try:
        _wait_for_frames(client)
        serial, simulated = client.status.serial, client.status.simulated
        check_serial(serial)
        unknown = "This service does not say which tracker is plugged in: keep this one."
        print(f"Tracker {serial}." if serial else unknown)
        where = "at one height, anywhere" if options.level else "in the order of the points"
        print(f"Touch the tops with the tip of the stretched index finger, palm down, {where}; show no other hand.")
        touched = {}
        for i, name in enumerate(points, start=1):
            touched[name] = _touch(client, f"{i} of {len(points)}: {name}", ask)
        if (client.status.serial, client.status.simulated) != (serial, simulated):
            raise RigError(f"Another tracker, {client.status.serial or 'unknown'}, was plugged in meanwhile.")
    finally:
        client.close()
    found = fit_level(touched) if options.level else fit(points, touched)
    _report(found, list(points))
    check_fit(found, list(points), 1e-3 * options.limit, 1e-2 * options.scale_limit)
    store(path, found, serial, clock.time(), simulated)
    print(f"Stored in {path}. Start the rig with registration:={options.name}.")


def _points(file: Path) -> dict[str, Sequence[float]]:
    """Returns the points of a file; raises RigError or ConfigError for a file that cannot be used."""
    values = read_yaml(file)
    if not isinstance(values, dict):
        raise RigError(f"The points {file} are not a mapping of names to positions.")
    faults: list[str] = []
    read = {str(name): parse_part(_Point, {"at": at}, f"{file}: {name} ", faults) for name, at in values.items()}
    if faults:
        raise ConfigError(faults)
    return {name: point.at.tolist() for name, point in read.items() if point is not None}


def _refuse_running_driver() -> None:
    """Raises RigError while a driver publishes: the hand that is shown would steer the arm."""
    try:
        publishers, _, _ = ask_master("getSystemState") or ([], [], [])
    except MasterLost:
        return
    if any(topic.endswith("leap_motion/leap_device") and nodes for topic, nodes in publishers):
        raise RigError("The rig runs, and would follow the hand that you show: stop it, then register the tracker.")


def _wait_for_frames(client: LeapClient) -> None:
    connect_s = 10.0
    deadline = clock.monotonic() + connect_s
    while client.next_frame(0.2) is None or client.status.link is not LeapLink.STREAMING:
        if clock.monotonic() > deadline:
            raise RigError(client.status.sentence)


def _touch(client: LeapClient, instruction: str, ask: Callable[[str], str]) -> np.ndarray:
    """Returns the tip that touches a point, shape (3,) [m]; asks until a hand holds still."""
    while True:
        ask(f"{instruction}. Hold still and press Enter. ")
        try:
            return still_tip(_frames(client))
        except RegistrationRefused as error:
            print(f"    {error}")


def _frames(client: LeapClient) -> list[LeapFrame]:
    client.next_frame(0.0)  # one from before
    frames, end = [], clock.monotonic() + HOLD_S
    while (left := end - clock.monotonic()) > 0.0:
        received = client.next_frame(left)
        if received is not None:
            frames.append(received.frame)
    return frames


def _report(found: PointFit, names: list[str]) -> None:
    for name, residual in zip(names, found.residuals):
        print(f"    {name:12} off by {1e3 * residual:4.1f} mm")
    x, y, z = (1e3 * found.T_desk_leap[:3, 3]).tolist()
    print(f"The tracker is tilted by {tilt_deg(found.T_desk_leap):.1f} deg, at {x:.0f}, {y:.0f}, {z:.0f} mm.")
