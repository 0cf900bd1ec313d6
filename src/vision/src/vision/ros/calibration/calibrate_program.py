"""The program calibrate_camera: the arm shows the marker board to the camera from many sides to find the camera pose.

It asks before the arm moves and before a result is kept. The detector and the node camera_place run beside it.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from contextlib import closing, suppress
from itertools import chain
from pathlib import Path

import numpy as np
import rospy
from std_srvs.srv import Trigger

from common import clock
from common.command_line import real
from common.errors import DeviceError, RigError
from common.mounting import rotation_of_mounting
from common.poses import inverse
from common.ros.node import join, run_program
from common.ros.params import wait_for_config
from common.ros.service_calls import ServiceFailed, call
from common.rotations import rotation_angle
from rig_description.urdf import urdf
from vision.calibration.acceptance import judge, mean_pose, table, view_from
from vision.calibration.arm_model import ArmModel
from vision.calibration.hand_eye import CalibrationView, DegenerateViews
from vision.calibration.record import by_views
from vision.calibration.view_planner import ViewPlanner, ViewsConfig, guessed_camera
from vision.ros.calibration.calibration_setup import NAMESPACE, CalibrationSetup, TfPoses, read, read_setup
from vision.ros.calibration.rviz_comparison import RvizComparison
from vision.ros.marker_board.detections import VIEW_TIMEOUT_S, BoardListener, ViewCapture
from vision.ros.ptp_arm import PtpArm, arm_address

NODE = "calibrate_camera"
DETECTOR = "apriltag_ros_continuous_node"
SETTLE_S = 0.6
FIRST_VIEWS = 6
FULL_SPEED_RAD_S = np.radians(98.0)


class CalibrationRefused(RigError):
    """The operator declined, or the calibration is not good enough; nothing was stored."""


def main() -> None:
    """Runs the program and exits the process: 0 stored, 1 refused or impossible, 130 interrupted."""
    options = _parser().parse_args(rospy.myargv()[1:])
    interrupted = "Interrupted; nothing was stored. A motion that has begun continues to its goal."
    run_program(NODE, lambda: _run(options), interrupted)


def _run(options: argparse.Namespace) -> None:
    join(NODE)
    setup = read_setup(DETECTOR)
    setup.check_serial()
    listener, comparison = BoardListener(setup.target), RvizComparison()
    if options.again:
        record = read(options.again)
        present = {key: value for key, value in setup.head.items() if key != "date"}
        pairs = ((key, getattr(record, key), value) for key, value in present.items())
        others = "; ".join(f"{key} {stored}, not {value}" for key, stored, value in pairs if stored != value)
        if others:
            raise DeviceError(f"The file belongs to another rig: {others}. Start camera_apriltag.launch for that rig.")
        setup.store.check(record, options.again)
        views, frame, simulated = list(record.views), record.camera_frame, record.simulated
    else:
        take = _views_by_hand if options.by_hand else _views_by_arm
        views, frame = take(options, setup, listener), listener.frame
        simulated = setup.measured_by(options.ip or rospy.get_param("kuka/ip", ""))
    _conclude(options, setup, views, {"camera_frame": frame, "simulated": simulated}, comparison)


def _views_by_hand(
    options: argparse.Namespace, setup: CalibrationSetup, listener: BoardListener
) -> list[CalibrationView]:
    """Returns the views at which the operator pressed Enter; the arm is moved by hand, or by a controller."""
    flange_wait_s = 3.0
    capture = ViewCapture(setup, listener, DETECTOR)
    if not options.ip:
        poses = TfPoses()
        try:
            poses.flange(rospy.Time(0), flange_wait_s)
        except DeviceError as error:
            raise DeviceError(f"{error} Without a controller use --ip: the program then asks the arm itself.") from None
        return _taken_by_hand(setup, capture, lambda: poses.flange(rospy.Time.now(), flange_wait_s))
    address = arm_address(setup.store_config, options)
    model = ArmModel(urdf(address.robot, address.flange))
    with closing(PtpArm(address, model, options.velocity)) as arm:
        return _taken_by_hand(setup, capture, arm.flange)


def _taken_by_hand(
    setup: CalibrationSetup, capture: ViewCapture, flange: Callable[[], np.ndarray]
) -> list[CalibrationView]:
    """Returns the views; `flange` returns the present T_base_flange, shape (4, 4) [m]."""
    still_m = 5e-4
    views: list[CalibrationView] = []
    flange()
    print("Move the arm so that the camera sees the board tilted, each time another way. Enter: take, q: finish.")
    while _answer(f"View {len(views) + 1}: ") not in ("q", None):
        try:
            before = flange()
            detections, how = capture.capture()
            T_base_flange = flange()
            if np.linalg.norm(T_base_flange[:3, 3] - before[:3, 3]) > still_m:
                raise ValueError("the arm moved; hold it still")
            views.append(view_from(detections, T_base_flange, views, setup.limits))
            print(f"  taken, {len(detections)} images, {how}")
        except (ValueError, DeviceError) as error:
            print(f"  not taken: {error}")
    return views


def _views_by_arm(
    options: argparse.Namespace, setup: CalibrationSetup, listener: BoardListener
) -> list[CalibrationView]:
    address = arm_address(setup.store_config, options)
    config = wait_for_config(ViewsConfig, f"{NAMESPACE}/views")
    model = ArmModel(urdf(address.robot, address.flange))
    R_world_base = rotation_of_mounting(address.mounting)
    capture = ViewCapture(setup, listener, DETECTOR)
    planner = ViewPlanner(config, model, capture.camera, setup.target.corners, setup.board, R_world_base)
    rng = np.random.default_rng(options.seed)
    if not options.yes and not sys.stdin.isatty():
        raise CalibrationRefused("Without a terminal the program cannot ask whether the arm may move; use --yes.")
    turned = "turned by roll {:g}, pitch {:g}, yaw {:g} deg against the upright world".format(*address.mounting)
    base = turned if address.mounting.any() else "upright"
    print(f"The arm is {address.robot} with {address.flange}, its base {base}.")
    angles = ", ".join(f"{angle:g}" for angle in config.start)
    print(f"It moves to {angles} deg, and then to the views, at {options.velocity:.0%} of full speed.")
    _confirm(options, "Is its path free, and may it move?")
    with closing(PtpArm(address, model, options.velocity)) as arm:
        found, start = setup.store.newest(), np.radians(config.start)
        guess = guessed_camera(config, R_world_base) if found is None else found[0].T_base_camera
        _go_to_start(arm, planner, guess, start)
        guess = _detected_guess(arm, setup, listener, planner, guess, start, rng)
        print("The camera sees the marker board. Choosing the views ...")
        here = arm.joints()
        legs = planner.tour(planner.choose(planner.candidates(guess, rng), guess), here, guess)
        if len(legs) < setup.limits.min_views:
            raise DeviceError(
                f"The arm can reach only {len(legs)} views, but {setup.limits.min_views} are needed: check guess, "
                "distance and min_height in calibration_views.yaml."
            )
        stops = [here, *chain(*legs)]
        turned = np.abs(np.diff(stops, axis=0)).max(axis=1).sum()
        seconds = turned / (options.velocity * FULL_SPEED_RAD_S) + len(legs) * (SETTLE_S + 1.5)
        _confirm(options, f"Move to {len(legs)} views, about {seconds:.0f} s?")
        views: list[CalibrationView] = []
        for i, leg in enumerate(legs, start=1):
            for q in leg:
                arm.move_to(q)
            clock.sleep(SETTLE_S)
            try:
                detections, how = capture.capture()
                views.append(view_from(detections, arm.flange(), views, setup.limits))
                distance = np.linalg.norm(views[-1].T_camera_board[:3, 3])
                print(f"View {i} of {len(legs)}: marker board at {distance:.2f} m, {len(detections)} images, {how}.")
            except ValueError as error:
                print(f"View {i} of {len(legs)} is not used: {error}.")
        for q in planner.path_back(here, legs, guess):
            arm.move_to(q)
        return views


def _go_to_start(arm: PtpArm, planner: ViewPlanner, guess: np.ndarray, start: np.ndarray) -> None:
    """Raises DeviceError if the start, or the straight joint motion to it, is not clear."""
    if planner.clearance(start, guess) <= 0.0:
        raise DeviceError(
            "At the start the arm, hand or marker board would be too close to the table, the camera or the arm: "
            "correct start, min_height and guess in calibration_views.yaml, and the mounting in camera_apriltag.launch."
        )
    if not planner.path_clear(arm.joints(), start, guess):
        raise DeviceError(
            "On the straight joint motion to the start the arm, hand or marker board would come too close to the "
            "table, the camera or the arm: first move the arm away with rosrun kuka_control simple_controller.py."
        )
    arm.move_to(start)


def _detected_guess(arm, setup, listener, planner: ViewPlanner, guess, start, rng) -> np.ndarray:
    """Returns T_base_camera, shape (4, 4), by the board's drawing, from the first pose at which the camera sees it."""
    views = planner.candidates(guess, rng, centre_only=True)[:FIRST_VIEWS]
    legs = [[], *planner.tour(views, start, guess)]
    for leg in legs:
        for q in leg:
            arm.move_to(q)
        clock.sleep(SETTLE_S)
        detections = listener.collect(setup.limits.pictures, VIEW_TIMEOUT_S)
        if detections:
            T_camera_board = mean_pose([detection.T_camera_board for _, detection in detections])
            return arm.flange() @ setup.board.T_flange_tag @ inverse(T_camera_board)
        print("The camera does not see the marker board here.")
        silence = listener.fault()
        if silence:
            raise DeviceError(f"The detector gives no answer: {silence}.")
    raise DeviceError(
        f"The camera saw the marker board at none of {len(legs)} arm poses: correct guess_position and guess_target in "
        "calibration_views.yaml, or move the arm so that the camera sees the marker board and use --by-hand."
    )


def _conclude(
    options: argparse.Namespace, setup: CalibrationSetup, views: list, measured: dict, comparison: RvizComparison
) -> None:
    """Solves, reports, shows, asks and stores; raises CalibrationRefused unless the result is good and confirmed.
    `measured`: the entries of the record that say by which camera frame, and whether by simulated devices."""
    reload_s = 1.0
    try:
        verdict = judge(views, setup.board.T_flange_tag, setup.limits)
    except DegenerateViews as error:
        raise CalibrationRefused(f"No calibration: {error}. The previous one stays valid.") from None
    print("\n".join(table(verdict)))
    print(f"The marker board is {verdict.board[0]:.2f} mm and {verdict.board[1]:.2f} deg from its drawing.")
    size, depth = verdict.size - 1.0, verdict.depth - 1.0
    print(f"By the arm's motion sizes appear {size:+.2%} and distances {depth:+.2%} too large.")
    found = setup.store.newest()
    new = verdict.result.T_base_camera
    comparison.show(None if found is None else found[0].T_base_camera, new)
    if found is not None:
        between = inverse(found[0].T_base_camera) @ new
        turn = np.degrees(rotation_angle(between[:3, :3]))
        shift = 1e3 * np.linalg.norm(between[:3, 3])
        print(f"The camera pose differs by {shift:.1f} mm and {turn:.2f} deg from that in {found[1].name}.")
    print(verdict.sentence)
    if not verdict.accepted:
        raise CalibrationRefused("Nothing was stored; the previous calibration stays valid.")
    _confirm(options, "Keep it?")
    record = by_views(verdict, views, **measured, **setup.head)
    print(f"Stored in {setup.store.save(record)}.")
    with suppress(ServiceFailed):
        print(call("camera_place/reload", Trigger, timeout=reload_s, wait=reload_s).message)


def _confirm(options: argparse.Namespace, question: str) -> None:
    """Raises CalibrationRefused unless the operator agrees, or the option --yes does."""
    if options.yes:
        print(question.replace("?", "."))
    elif _answer(f"{question} [y/N] ") not in ("y", "yes"):
        raise CalibrationRefused("Cancelled; nothing was stored.")


def _answer(question: str) -> str | None:
    """Returns what the operator types, in lower case, or None at the end of the input."""
    try:
        return input(question).strip().lower()
    except EOFError:
        return None


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="calibrate_camera.py",
        description="Finds the camera pose: the arm shows the marker board to the camera from many sides.",
        epilog="Start roslaunch vision camera_apriltag.launch first. The robot is that of the parameters under kuka/ "
        "on the ROS master; the options override them.",
    )
    by_hand = "you move the arm: with a controller, or with --ip by the smartPad; Enter takes a view"
    again = "compute again from the views in a stored calibration"
    speed = "fraction of full joint speed, (0, 0.5] (%(default)s)"
    parser.add_argument("--by-hand", action="store_true", help=by_hand)
    parser.add_argument("--again", type=Path, metavar="FILE.yaml", help=again)
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument("--velocity", type=real(0.0, 0.5, open_low=True), default=0.15, help=speed)
    parser.add_argument("--seed", type=int, default=0, help="seed of the choice of the views")
    robot = parser.add_argument_group("robot")
    robot.add_argument("--ip", help="address of the robot's controller")
    robot.add_argument("--port", type=int, help="TCP port of the toolbox server")
    robot.add_argument("--robot", help="the arm: LBR7R800 or LBR14R820")
    robot.add_argument("--flange", help="its media flange")
    return parser
