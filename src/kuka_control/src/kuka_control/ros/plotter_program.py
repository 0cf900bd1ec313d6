"""The workspace plotter: parameters from a file or the server -> study -> sentences and a picture."""

from __future__ import annotations

import argparse
import os
from pathlib import Path

import numpy as np
import rospy
from geometry_msgs.msg import Point, Vector3
from matplotlib import colormaps, pyplot
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgba
from matplotlib.figure import Figure
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker, MarkerArray

from common import clock
from common.command_line import whole
from common.errors import RigError
from common.frames import BASE
from common.ros.files import read_yaml
from common.ros.node import join, run_program
from common.screen import check_screen
from kuka_control.gui.plot import FRACTIONS, SIZE_INCH, UNREACHED, WorkspacePicture, draw
from kuka_control.model.rig import checked_rig
from kuka_control.model.workspace_study import (
    ReachStudy,
    constrained_samples,
    sentences,
    study_reach,
    title,
    volume_samples,
)
from kuka_control.ros.parameter_server import NoMaster, NoParameters, dh_deviations, parameters, shipped

NAME = "workspace_plotter"
DEFAULT_PARAMS = "kuka_params_rt.yaml"
TOLERANCES_DEG = (25.0, 25.0, 25.0)  # where neither an option nor the parameter server says otherwise [deg]


def main() -> None:
    """Runs the program and exits the process: 0, or 1 after sentences on the errors."""
    options = _parser().parse_args(rospy.myargv()[1:])
    run_program(NAME, lambda: _run(options), "Interrupted.")


def _run(options: argparse.Namespace) -> None:
    if options.markers:
        join(NAME, anonymous=True)
    elif options.save is None:
        _check_window()
    else:
        _check_picture_name(options.save)
    config, rig = checked_rig(*_values(options), dh_deviations)
    tolerances = tuple(options.tolerances or (_server_tolerances() if options.from_server else TOLERANCES_DEG))
    random = np.random.default_rng(options.seed)
    positions = volume_samples(rig.workspace, options.samples, random)
    study = study_reach(
        rig.kinematics, rig.mounting, rig.home.q, positions, np.radians(tolerances), options.attitudes, random
    )
    notes = sentences(config, rig, study, tolerances)
    print(title(config))
    print("\n".join(notes), flush=True)
    if options.markers:
        return _publish(reach_marker(study))
    samples = constrained_samples(rig.workspace, options.constrained, random)
    picture = WorkspacePicture(title(config), tuple(notes[:6]), rig, samples, study)
    if options.save is not None:
        return _save(picture, options.save)
    draw(pyplot.figure(figsize=SIZE_INCH, num="Leap Rig: workspace"), picture)
    pyplot.show()


def _values(options: argparse.Namespace) -> tuple[dict, str]:
    """Returns the parameters, and what stands before their keys in messages."""
    if not options.from_server:
        return {**read_yaml(shipped(DEFAULT_PARAMS)), **(read_yaml(options.params) if options.params else {})}, ""
    try:
        return parameters("kuka"), "kuka/"
    except NoParameters as error:
        raise RigError(f"{error} Load them first: roslaunch kuka_control kuka_params_rt.launch") from error


def _server_tolerances() -> tuple[float, ...]:
    try:
        leap = parameters("leap")
        return tuple(float(leap[f"run_tol_{angle}"]) for angle in ("yaw", "pitch", "roll"))
    except (NoMaster, NoParameters, KeyError, TypeError, ValueError):
        return TOLERANCES_DEG


def _check_picture_name(path: Path) -> None:
    kinds = sorted(FigureCanvasAgg.get_supported_filetypes())
    if path.suffix[1:].lower() not in kinds:
        raise RigError(f"{path} is not the name of a picture: it must end in one of .{', .'.join(kinds)}.")
    if not path.parent.is_dir():
        raise RigError(f"There is no folder {path.parent} to save the picture in.")


def _save(picture: WorkspacePicture, path: Path) -> None:
    figure = Figure(figsize=SIZE_INCH)
    FigureCanvasAgg(figure)
    draw(figure, picture)
    try:
        figure.savefig(path, dpi=100)
    except OSError as error:
        raise RigError(f"The picture cannot be saved as {path}: {error.strerror}.") from error
    print(f"The picture is saved as {path}.")


def reach_marker(study: ReachStudy) -> Marker:
    """Returns the studied positions in the arm's base: red where the tool does not get pointing straight down, else in
    the colours of the picture by the fraction of the orientations that it reaches."""
    size_m = 0.012
    marker = Marker(ns="reach", type=Marker.POINTS, action=Marker.ADD, scale=Vector3(size_m, size_m, size_m))
    marker.header.frame_id, marker.pose.orientation.w, marker.frame_locked = BASE, 1.0, True
    colours = np.where(study.down[:, None], colormaps[FRACTIONS](study.fraction), to_rgba(UNREACHED))
    marker.points = [Point(*position) for position in study.positions.tolist()]
    marker.colors = [ColorRGBA(*colour) for colour in colours.tolist()]
    return marker


def _publish(marker: Marker) -> None:
    """Shows the marker beside the workspace that a controller shows, until it is interrupted."""
    sent_s = 0.5
    publisher = rospy.Publisher("kuka/workspace", MarkerArray, queue_size=1, latch=True)
    publisher.publish(MarkerArray([marker]))
    print("The cockpit and RViz show the positions beside a controller, until Ctrl-C.")
    try:
        _wait()
    finally:
        marker.action, marker.points, marker.colors = Marker.DELETE, [], []
        publisher.publish(MarkerArray([marker]))
        clock.sleep(sent_s)


def _wait() -> None:
    clock.Event().wait()  # for the exception of an interrupt


def _check_window() -> None:
    os.environ["QT_API"] = "pyqt5"  # python_qt_binding leaves a name here that matplotlib does not know
    cure = "Use --save FILE.png."
    check_screen("The window", cure)
    try:
        pyplot.switch_backend("QtAgg")
    except ImportError as error:
        raise RigError(f"The window is not opened: {error}. {cure}") from error


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog=f"{NAME}.py",
        description="Shows the workspace of the tool with the arm at home, how desired positions are constrained to "
        "it, and how much of it the arm reaches; says what is wrong with parameters that make no workspace.",
    )
    source = parser.add_mutually_exclusive_group()
    source.add_argument(
        "--params",
        type=Path,
        metavar="FILE.yaml",
        help=f"parameters of a controller, or those that differ from {DEFAULT_PARAMS}",
    )
    source.add_argument("--from-server", action="store_true", help="take the parameters under kuka/ of the ROS master")
    shown = parser.add_mutually_exclusive_group()
    shown.add_argument("--save", type=Path, metavar="FILE.png", help="save the picture instead of opening a window")
    shown.add_argument("--markers", action="store_true", help="show where the arm reaches in the cockpit and in RViz")
    parser.add_argument(
        "--tolerances",
        type=_angle,
        nargs=3,
        metavar=("YAW", "PITCH", "ROLL"),
        help="how far the tool may turn from straight down, deg; default: run_tol_* of leap_params on the server "
        "(with --from-server), else 25 25 25",
    )
    count = whole(1, 100_000)
    parser.add_argument("--samples", type=count, default=1000, help="positions of the study (default: %(default)s)")
    parser.add_argument(
        "--attitudes", type=count, default=12, help="orientations tried at each position (default: %(default)s)"
    )
    parser.add_argument(
        "--constrained", type=count, default=350, help="positions shown as constrained (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=1, help="of the random numbers (default: %(default)s)")
    return parser


def _angle(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 <= value <= 90.0:
        raise argparse.ArgumentTypeError(f"{text!r} is not an angle from 0 to 90 deg")
    return value
