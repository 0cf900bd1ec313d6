"""The program calibrate_camera: the arm shows the panel to the camera from many sides, and so its place is found.

It asks before the arm moves and before a result is kept. The detector and the node camera_place run beside it.
"""

from __future__ import annotations

import argparse
import contextlib
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import rospy
from std_srvs.srv import Trigger

from common.errors import ConfigError, DeviceError, RigError
from common.mounting import rotation_of_mounting
from common.poses import inverse
from common.ros.params import wait_for_config
from common.ros.service_calls import ServiceFailed, call
from common.rotations import rotation_angle
from rig_description.urdf import urdf
from vision.calibration.acceptance import judge, mean_pose, table, view_from
from vision.calibration.arm_model import ArmModel
from vision.calibration.hand_eye import Degenerate, View
from vision.calibration.record import CalibrationRecord, by_views
from vision.calibration.view_planner import Leg, Place, ViewPlanner, ViewsConfig, guessed_camera
from vision.ros.calibration.calibration_setup import NAMESPACE, CalibrationSetup, read_setup
from vision.ros.calibration.rviz_comparison import Comparison
from vision.ros.calibration.store import read
from vision.ros.calibration.tf_poses import Frames
from vision.ros.marker_board.detections import PanelSights
from vision.ros.marker_board.view_capture import VIEW_TIMEOUT_S, PanelViewer
from vision.ros.ptp_arm import ArmAddress, PtpArm, arm_address

NODE = "calibrate_camera"
DETECTOR = "apriltag_ros_continuous_node"
SETTLE_S = 0.6
RELOAD_S = 1.0
FIRST_PLACES = 6
FLANGE_WAIT_S = 3.0
STILL_M = 5e-4
INTERRUPTED = 130


class Refused(RigError):
    """The person said no, or the calibration is not good enough; nothing was stored."""


def main() -> None:
    """Runs the program and exits the process: 0 stored, 1 refused or impossible, 130 interrupted."""
    options = _parser().parse_args(rospy.myargv()[1:])
    sys.stdout.reconfigure(line_buffering=True)
    try:
        rospy.init_node(NODE, disable_signals=True)
        signal.signal(signal.SIGTERM, signal.default_int_handler)
        _run(options)
        code = 0
    except RigError as error:
        for sentence in error.faults if isinstance(error, ConfigError) else [str(error)]:
            print(f"calibrate_camera: {sentence}", file=sys.stderr)
        code = 1
    except KeyboardInterrupt:
        print("\nInterrupted; nothing was stored. A motion that has begun goes on to its goal.")
        code = INTERRUPTED
    rospy.signal_shutdown("the program ends")
    sys.exit(code)


def _run(options: argparse.Namespace) -> None:
    setup = read_setup(DETECTOR)
    setup.check_serial()
    sights, comparison = PanelSights(setup.target), Comparison()
    if options.again:
        record = read(options.again)
        _refuse_foreign(record, setup)
        views, frame = list(record.views), record.camera_frame
    elif options.by_hand:
        views = _views_by_hand(options, setup, PanelViewer(setup, sights, DETECTOR))
        frame = sights.frame
    else:
        views = _views_by_arm(options, setup, sights)
        frame = sights.frame
    _conclude(options, setup, views, frame, comparison)


def _refuse_foreign(record: CalibrationRecord, setup: CalibrationSetup) -> None:
    """Raises DeviceError if the views in a file are of another arm, media flange, camera or panel."""
    store = setup.store_config
    present = {"robot": store.robot, "flange": store.flange, "camera": store.camera, "panel": setup.panel.frame}
    others = [
        f"{key} {getattr(record, key)}, not {value}" for key, value in present.items() if getattr(record, key) != value
    ]
    if others:
        raise DeviceError(
            f"The file is not of this rig: {'; '.join(others)}. Start camera_apriltag.launch for the rig that it is of."
        )


def _views_by_hand(options: argparse.Namespace, setup: CalibrationSetup, viewer: PanelViewer) -> list[View]:
    """Returns the views at which the person pressed Enter; somebody else moves the arm."""
    if not options.ip:
        frames = Frames()
        try:
            frames.flange(rospy.Time(0), FLANGE_WAIT_S)
        except DeviceError as error:
            raise DeviceError(
                f"{error} Without a controller, give --ip: then the program asks the arm itself."
            ) from None
        return _taken_by_hand(setup, viewer, lambda: frames.flange(rospy.Time.now(), FLANGE_WAIT_S))
    address = _address(options, setup)
    arm = PtpArm(address, ArmModel(urdf(address.robot, address.flange)), options.velocity)
    try:
        return _taken_by_hand(setup, viewer, arm.flange)
    finally:
        _end(arm)


def _taken_by_hand(setup: CalibrationSetup, viewer: PanelViewer, flange: Callable[[], np.ndarray]) -> list[View]:
    """Returns the views; `flange` returns T_base_flange, shape (4, 4) [m], at present."""
    views: list[View] = []
    flange()
    print(
        "Move the arm so that the panel is seen tilted, each time about another axis. Enter: take it, q: that is all."
    )
    while _answer(f"View {len(views) + 1}: ") not in ("q", None):
        try:
            before = flange()
            seen, how = viewer.look()
            T_base_flange = flange()
            if np.linalg.norm(T_base_flange[:3, 3] - before[:3, 3]) > STILL_M:
                raise ValueError("the arm moved")
            views.append(view_from(seen, T_base_flange, views, setup.limits))
            print(f"  taken, {len(seen)} pictures, {how}")
        except (ValueError, DeviceError) as error:
            print(f"  not taken: {error}")
    return views


def _views_by_arm(options: argparse.Namespace, setup: CalibrationSetup, sights: PanelSights) -> list[View]:
    address = _address(options, setup)
    config = wait_for_config(ViewsConfig, f"{NAMESPACE}/views")
    model = ArmModel(urdf(address.robot, address.flange))
    R_world_base = rotation_of_mounting(address.mounting)
    points = np.concatenate([tag.corners for tag in setup.target.tags])
    viewer = PanelViewer(setup, sights, DETECTOR)
    planner = ViewPlanner(
        config, model, viewer.camera, points, setup.panel.plate, setup.panel.T_flange_tag, R_world_base
    )
    rng = np.random.default_rng(options.seed)
    if not options.yes and not sys.stdin.isatty():
        raise Refused("There is no terminal to ask on whether the arm may move; use --yes.")
    print(f"The arm is {address.robot} with {address.flange}, its {address.orientation}.")
    print(f"It goes to {_text(config.start)} deg, and then to the views, at {options.velocity:.0%} of full speed.")
    _agree(options, "Is the way free, and may it move?")
    arm = PtpArm(address, model, options.velocity)
    try:
        guess = _first_guess(setup, config, R_world_base)
        _go_to_start(arm, planner, guess, np.radians(config.start))
        guess = _sighted_guess(arm, setup, sights, planner, guess, np.radians(config.start), rng)
        print("The panel is seen. Choosing the views ...")
        here = arm.joints()
        legs = planner.tour(planner.choose(planner.candidates(guess, rng), guess), here, guess)
        if len(legs) < setup.limits.min_views:
            raise DeviceError(
                f"Only {len(legs)} views can be reached, {setup.limits.min_views} are needed: check the guess, "
                "the distances and min_height in calibration_views.yaml."
            )
        _agree(options, f"Visit {len(legs)} views, about {_duration(legs, here, options.velocity):.0f} s?")
        views = _visit(arm, legs, setup, viewer)
        for q in planner.way_back(here, legs, guess):
            arm.move_to(q)
        return views
    finally:
        _end(arm)


def _address(options: argparse.Namespace, setup: CalibrationSetup) -> ArmAddress:
    return arm_address(setup.store_config, {key: getattr(options, key) for key in ("ip", "port", "robot", "flange")})


def _end(arm: PtpArm) -> None:
    arm.close()
    print("The connection is closed and the server on the robot ends with it; start it again for the next program.")


def _go_to_start(arm: PtpArm, planner: ViewPlanner, guess: np.ndarray, start: np.ndarray) -> None:
    """Raises DeviceError if the start, or the way there, all joints together, is not clear."""
    if planner.clearance(start, guess) <= 0.0:
        raise DeviceError(
            "At the start the arm, hand or panel would be too near to the table, the camera or the arm: correct start, "
            "min_height and the guess in calibration_views.yaml, and mounting:=... of camera_apriltag.launch."
        )
    if not planner.way_clear(arm.joints(), start, guess):
        raise DeviceError(
            "On the straight way of the joints to the start the arm, hand or panel would come too near to the table, "
            "the camera or the arm: bring the arm elsewhere first, with rosrun kuka_control simple_controller.py."
        )
    arm.move_to(start)


def _first_guess(setup: CalibrationSetup, config: ViewsConfig, R_world_base: np.ndarray) -> np.ndarray:
    found = setup.store.newest()
    return guessed_camera(config, R_world_base) if found is None else found[0].T_base_camera


def _sighted_guess(arm, setup, sights, planner: ViewPlanner, guess, start, rng) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), by the panel's drawing, from the first place at which the panel is seen.

    Raises:
        DeviceError: it is seen nowhere.
    """
    legs = [Leg(Place(start, arm.flange()), ())]
    legs += planner.tour(planner.candidates(guess, rng, centre_only=True)[:FIRST_PLACES], start, guess)
    for leg in legs:
        for q in leg.way:
            arm.move_to(q)
        time.sleep(SETTLE_S)
        seen = sights.collect(setup.limits.pictures, VIEW_TIMEOUT_S)
        if seen:
            T_camera_panel = mean_pose([sight.T_camera_panel for sight in seen])
            return arm.flange() @ setup.panel.T_flange_tag @ inverse(T_camera_panel)
        print("The panel is not seen here.")
        if sights.last_picture is None:
            raise DeviceError("The detector publishes nothing: is the camera running?")
    raise DeviceError(
        f"The panel was not seen at {len(legs)} places: correct guess_position and guess_target in "
        "calibration_views.yaml, or move the arm so that the camera sees the panel and use --by-hand."
    )


def _visit(arm: PtpArm, legs: list[Leg], setup: CalibrationSetup, viewer: PanelViewer) -> list[View]:
    views: list[View] = []
    for i, leg in enumerate(legs, start=1):
        for q in leg.way:
            arm.move_to(q)
        time.sleep(SETTLE_S)
        seen, how = viewer.look()
        try:
            views.append(view_from(seen, arm.flange(), views, setup.limits))
            distance = np.linalg.norm(views[-1].T_camera_panel[:3, 3])
            print(f"View {i} of {len(legs)}: panel at {distance:.2f} m, {len(seen)} pictures, {how}.")
        except ValueError as error:
            print(f"View {i} of {len(legs)} does not count: {error}.")
    return views


def _conclude(
    options: argparse.Namespace, setup: CalibrationSetup, views: list[View], frame: str, comparison: Comparison
) -> None:
    """Solves, tells, shows, asks and stores.

    Raises:
        Refused: the result is not good enough, or the person does not want it.
    """
    try:
        verdict = judge(views, setup.panel.T_flange_tag, setup.limits)
    except Degenerate as error:
        raise Refused(f"There is no calibration: {error}. The one before stays.") from None
    print("\n".join(table(verdict)))
    print(f"The panel sits {verdict.panel[0]:.2f} mm and {verdict.panel[1]:.2f} deg from its drawing.")
    print(
        f"By the arm's motion sizes look {verdict.size - 1.0:+.2%} and distances {verdict.ahead - 1.0:+.2%} too large."
    )
    found = setup.store.newest()
    new = verdict.result.T_base_camera
    comparison.show(None if found is None else found[0].T_base_camera, new)
    if found is not None:
        between = inverse(found[0].T_base_camera) @ new
        turn = np.degrees(rotation_angle(between[:3, :3]))
        shift = 1e3 * np.linalg.norm(between[:3, 3])
        print(f"The camera is {shift:.1f} mm and {turn:.2f} deg from where {found[1].name} has it.")
    print(verdict.sentence)
    if not verdict.accepted:
        raise Refused("Nothing was stored; the calibration before stays.")
    _agree(options, "Keep it?")
    store = setup.store_config
    record = by_views(
        verdict,
        views,
        date=time.strftime("%Y-%m-%dT%H:%M:%S"),
        robot=store.robot,
        flange=store.flange,
        panel=setup.panel.frame,
        camera=store.camera,
        camera_frame=frame,
    )
    print(f"Stored in {setup.store.save(record)}.")
    with contextlib.suppress(ServiceFailed):
        print(call("camera_place/reload", Trigger, timeout=RELOAD_S, wait=RELOAD_S).message)


def _agree(options: argparse.Namespace, question: str) -> None:
    if options.yes:
        print(question.replace("?", "."))
        return
    if _answer(f"{question} [y/N] ") not in ("y", "yes"):
        raise Refused("Then not; nothing was stored.")


def _answer(question: str) -> str | None:
    """Returns what the person types, in lower case, or None at the end of the input."""
    try:
        return input(question).strip().lower()
    except EOFError:
        return None


def _duration(legs: list[Leg], q: np.ndarray, velocity: float) -> float:
    """Returns roughly how long the visit takes [s]."""
    turned, stops = 0.0, 0
    for leg in legs:
        for goal in leg.way:
            turned, q = turned + float(np.max(np.abs(goal - q))), goal
        stops += 1
    return turned / (velocity * np.radians(98.0)) + stops * (SETTLE_S + 1.5)


def _text(angles: np.ndarray) -> str:
    return ", ".join(f"{angle:g}" for angle in angles)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calibrate_camera.py",
        description="Finds where the camera stands: the arm shows the marker panel to it from many sides.",
        epilog="Start roslaunch vision camera_apriltag.launch first. The robot is that of the parameters under kuka/ "
        "on the ROS master; the options stand above them.",
    )
    parser.add_argument(
        "--by-hand",
        action="store_true",
        help="somebody else moves the arm: a controller, or with --ip whoever holds the smartPad; Enter takes a view",
    )
    parser.add_argument(
        "--again", type=Path, metavar="FILE.yaml", help="compute anew from the views in a stored calibration"
    )
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument(
        "--velocity", type=_share, default=0.15, help="share of full joint speed, (0, 0.5] (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the choice of the views")
    robot = parser.add_argument_group("robot")
    robot.add_argument("--ip", help="address of the robot's controller")
    robot.add_argument("--port", type=int, help="TCP port of the toolbox server")
    robot.add_argument("--robot", help="the arm: LBR7R800 or LBR14R820")
    robot.add_argument("--flange", help="its media flange")
    return parser


def _share(text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = float("nan")
    if not 0.0 < value <= 0.5:
        raise argparse.ArgumentTypeError(f"{text!r} is not a number in (0, 0.5]")
    return value
