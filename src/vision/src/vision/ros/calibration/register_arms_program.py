"""The program register_arms: where the second of two arms stands, from the calibrations of one camera to both.

It reads two calibrations that calibrate_camera.py stored, prints the result in a sentence, and writes the yaml file for
`arms:=FILE`. It needs no ROS master.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import rospkg

from common.arms import Arms, BasePlacement, arms_from
from common.command_line import exit_code
from common.errors import RigError
from common.ros.files import read_yaml, write_whole
from common.rotations import zyx_from_rotation
from common.simulated import SIMULATED, any_simulated, origin
from vision.calibration.arm_registration import ArmRegistration, register
from vision.calibration.hand_eye import DegenerateViews, HandEyeSolution, solve
from vision.calibration.record import VIEWS, CalibrationRecord
from vision.ros.calibration.calibration_setup import PREFIX, read

NAME = "register_arms"


def main(arguments: list[str] | None = None) -> int:
    """Runs the program; returns the exit code."""
    options = _parser().parse_args(arguments)
    return exit_code(NAME, lambda: print(_run(options)))


def _run(options: argparse.Namespace) -> str:
    arms = arms_from(read_yaml(options.arms), "arms/")
    (first, file), (second, other) = (_calibration(given) for given in (options.first, options.second))
    names = options.first[0], options.second[0]
    unknown = [name for name in names if name not in arms.placements]
    if unknown or names[0] == names[1]:
        known = " and ".join(arms.placements)
        raise RigError(f"The arms are {' and '.join(names)}, but {options.arms} places {known}; name both of them.")
    kept = [name for name in arms.placements if name not in names]
    if kept:
        raise RigError(f"{options.arms} also places {', '.join(kept)}; this program registers two arms.")
    for what in ("camera", "camera_frame"):
        pair = getattr(first, what), getattr(second, what)
        if pair[0] != pair[1]:
            raise RigError(f"{file} and {other} are of different cameras ({what} {pair[0]} and {pair[1]}).")
    found = register(_solution(first, file), _solution(second, other))
    T_world_first = arms.placements[names[0]].T_world_base
    T_world_second = T_world_first @ found.T_first_second
    sentence = _sentence(names, found)
    simulated = any_simulated(first.simulated, second.simulated)
    write_whole(options.output, _content(names, arms, T_world_second, (first, second), simulated, sentence))
    return (
        f"{sentence} Measured {origin(simulated)}. This holds if the camera was not moved between {first.date} and "
        f"{second.date}. Written to {options.output}; start the rig with arms:={options.output.resolve()}."
    )


def _calibration(given: tuple[str, Path]) -> tuple[CalibrationRecord, Path]:
    """Returns the calibration of an arm, and its file: the newest one where a folder is given."""
    _, path = given
    if path.is_dir():
        files = sorted(path.glob(f"{PREFIX}*.yaml"))
        if not files:
            raise RigError(
                f"The folder {path} has no calibration, {PREFIX}*.yaml; run calibrate_camera.py for that arm."
            )
        path = files[-1]
    record = read(path)
    if record.kind != VIEWS:
        raise RigError(f"{path} depends on a single view; calibrate the camera by several, with calibrate_camera.py.")
    return record, path


def _solution(record: CalibrationRecord, file: Path) -> HandEyeSolution:
    try:
        return solve(list(record.views))
    except DegenerateViews as error:
        raise RigError(f"{file} cannot be used: {error}.") from error


def _sentence(names: tuple[str, str], found: ArmRegistration) -> str:
    between_m = 0.5  # in front of the second base, where the hands meet: the uncertainty is stated there [m]
    x, y, z = found.T_first_second[:3, 3].tolist()
    yaw, pitch, roll = np.degrees(zyx_from_rotation(found.T_first_second[:3, :3])).tolist()
    before = found.T_first_second @ (between_m, 0.0, 0.0, 1.0)
    sd = np.array2string(1e3 * found.position_sd, precision=1, separator=", ")[1:-1]
    turn = float(np.degrees(np.linalg.norm(found.turn_sd)))
    return (
        f"The base of {names[1]} stands at x {x:.4f}, y {y:.4f}, z {z:.4f} m in the base of {names[0]}, turned by roll "
        f"{roll:.2f}, pitch {pitch:.2f}, yaw {yaw:.2f} deg; standard deviations {sd} mm and {turn:.2f} deg, "
        f"{1e3 * found.point_sd(before[:3]):.1f} mm for a point {between_m:g} m before it."
    )


def _content(
    names: tuple[str, str],
    arms: Arms,
    T_world_second: np.ndarray,
    records: tuple[CalibrationRecord, CalibrationRecord],
    simulated: bool | None,
    sentence: str,
) -> str:
    yaw, pitch, roll = np.degrees(zyx_from_rotation(T_world_second[:3, :3])).tolist()
    second = BasePlacement(T_world_second[:3, 3], np.array([roll, pitch, yaw]))
    placements: Mapping[str, BasePlacement] = {names[0]: arms.placements[names[0]], names[1]: second}
    lines = [
        f"# Two arms, registered by camera {records[0].camera} on {records[0].date} and {records[1].date}.",
        f"# {sentence}",
        "",
        f"margin: {arms.margin:g}",
    ]
    lines += [] if simulated is None else [f"{SIMULATED}: {str(simulated).lower()}"]
    for name in arms.placements:
        place = placements[name]
        lines += ["", f"{name}:", f"  position: {_row(place.position, 5)}  # m", f"  rpy: {_row(place.rpy, 4)}  # deg"]
    return "\n".join(lines) + "\n"


def _row(values: np.ndarray, digits: int) -> str:
    return f"[{', '.join(f'{value:.{digits}f}' for value in values.tolist())}]"


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"{NAME}.py",
        description="Finds where the second of two arms stands, from the calibrations of one fixed camera to both.",
        epilog="Mount the marker board on one arm and run calibrate_camera.py, then on the other; keep the results in "
        "two folders (camera_apriltag.launch folder:=DIR), and do not touch the camera in between.",
    )
    which = "{} arm and its calibration: a file, or a folder, of which the newest counts"
    parser.add_argument("first", type=_named, metavar="NAME=PATH", help=which.format("the first"))
    parser.add_argument("second", type=_named, metavar="NAME=PATH", help=which.format("the second"))
    shipped = Path(rospkg.RosPack().get_path("kuka_control")) / "config" / "two_arms.yaml"
    what = "yaml file with the margin and where the first arm stands (%(default)s)"
    parser.add_argument("--arms", type=Path, default=shipped, metavar="FILE", help=what)
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="yaml file to write")
    return parser


def _named(text: str) -> tuple[str, Path]:
    name, sign, path = text.partition("=")
    if not (name and sign and path):
        raise argparse.ArgumentTypeError(f"{text!r} is not of the form NAME=PATH, such as left=~/.ros/leap_rig/left")
    return name, Path(path).expanduser()
