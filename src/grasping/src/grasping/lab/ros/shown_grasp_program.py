"""The collection of 2019 as a program: maps of a thing with the arm at home, then poses of the tool at its grasp.

It runs beside the rig. With the arm at home it takes the maps. Then the operator brings the hand to the grasp and keeps
it there, and Enter starts the poses. They pause while no hand is followed, and continue with the next Enter. Each
desired pose is written at once with the measured one beside it, as an episode that train_refinement.py reads; Ctrl-C
keeps what is written.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TextIO

import numpy as np
import rospy
import tf2_ros
from sensor_msgs.msg import Image
from tqdm import tqdm

from common import clock
from common.errors import RigError
from common.frames import TOOL_DESIRED
from common.ros.compressed_images import depth_topic
from common.ros.files import write_whole
from common.ros.inputs import NodeInputs, clause
from common.ros.node import join, run_program
from common.teleop_record import teleop_record
from grasping.lab.dataset.episode import NOWHERE, SHOWN
from grasping.lab.dataset.shown_grasp import Phase, ShownGrasp
from grasping.lab.dataset.store import encode, file_name
from grasping.lab.ros.collection_setup import CollectionSetup, default_values, setup_from
from grasping.lab.ros.frame_reader import FrameReader
from grasping.pipeline.view import NoView
from grasping.ros.pose_lookup import PoseLookup
from rig_msgs.msg import KukaStatus, TeleopState

NAME = "collect_shown_grasp"
STALE_S = 0.5


class ShownGraspRecorder:
    """Passes images and poses to a session, and its episodes to the folder."""

    def __init__(self, setup: CollectionSetup, session: ShownGrasp) -> None:
        self._setup, self.session = setup, session
        self._poses = PoseLookup()
        topics = setup.ggcnn.input
        self._inputs = NodeInputs([topics.depth_topic], once=[topics.info_topic])
        self._reader = FrameReader(setup, self._poses, self._inputs)
        self._lock = clock.Lock()
        self._mode: tuple[str, float] = "", -np.inf
        self._T_base_camera = NOWHERE
        self.waits_for = ""  # a clause, why nothing is taken; empty while something is
        self.following = False
        rospy.Subscriber("kuka/status", KukaStatus, self._on_status, queue_size=1)
        rospy.Subscriber("leap_kuka/state", TeleopState, self._on_teleop, queue_size=10)
        self._inputs.subscribe(*depth_topic(topics.depth_topic, self._on_depth))

    def take_pose(self) -> bool:
        """Writes the episode of the tool's desired pose if one is due. Returns whether it did; else `waits_for` says
        why not, or is empty. Raises RigError if the disk does not take it.
        """
        now = rospy.Time.now()
        if not self.session.due(now.to_sec()):
            return False
        if not self.following:
            self.waits_for = "no hand is followed"
            return False
        try:
            T_base_tool = self._poses.flange(STALE_S) @ self._setup.kuka.T_flange_tool
            T_base_tool_desired = self._poses.newest(TOOL_DESIRED, STALE_S)
        except (ValueError, tf2_ros.TransformException) as error:
            self.waits_for = clause(error)
            return False
        self.waits_for = ""
        frames, grasp = self.session.add_pose(now.to_sec(), T_base_tool)
        setup = self._setup
        metadata = setup.metadata(grasp, SHOWN, setup.config.object, frames.optics.real, self._T_base_camera)
        tool = setup.kuka.T_flange_tool, setup.T_tool_grasp
        episode = frames.episode(grasp, metadata, *tool, T_base_tool_desired)
        file = setup.folder / file_name(episode)
        try:
            write_whole(file, encode(episode))
        except OSError as error:
            raise RigError(f"{file} could not be written: {error.strerror}. The poses before it are stored.") from None
        return True

    def watch_images(self) -> None:
        """Lets `waits_for` say that no images come."""
        self.waits_for = self._inputs.missing() or self.waits_for

    def _on_status(self, message: KukaStatus) -> None:
        self._mode = message.mode, clock.monotonic()

    def _on_teleop(self, message: TeleopState) -> None:
        self.following = teleop_record(message).running

    def _on_depth(self, message: Image) -> None:
        try:
            self._take_map(message)
        except (ValueError, NoView, tf2_ros.TransformException) as error:
            self.waits_for = clause(error)

    def _take_map(self, message: Image) -> None:
        """Takes a map if one is due; raises ValueError, NoView or TransformException that names what is missing."""
        if self.session.phase is not Phase.MAPS or not self.session.due(message.header.stamp.to_sec()):
            return
        self._check_at_home()
        placed = self._reader.place(message)
        seen = self._reader.look(placed)
        if seen.on_robot:
            raise ValueError("GGCNN takes the robot for a thing")
        self._check_at_home()
        self.waits_for = ""
        self._T_base_camera = placed.T_base_camera
        if self.session.add_map(seen.frame, seen.optics):
            rospy.logwarn("The camera changed: the maps before are dropped.")

    def _check_at_home(self) -> None:
        mode, at = self._mode
        if clock.monotonic() - at > STALE_S:
            raise ValueError("the arm's controller is silent")
        if mode != KukaStatus.HOME:
            raise ValueError(f"the arm is not at home: {mode}")


class Enters:
    """The Enter key, without waiting for it."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream
        self._pressed = clock.Event()
        self.ended = False
        clock.Thread(target=self._read, name="enter", daemon=True).start()

    def pressed(self) -> bool:
        """Returns whether it was pressed since the last call."""
        was = self._pressed.is_set()
        self._pressed.clear()
        return was

    def _read(self) -> None:
        for _ in self._stream:
            self._pressed.set()
        self.ended = True


def main() -> None:
    parser = argparse.ArgumentParser(prog=f"{NAME}.py", description=__doc__)
    add = parser.add_argument
    add("object", help="name of the thing")
    add("--operator", default="unnamed", help="who teleoperates")
    add("--maps", type=int, default=1000, help="default: %(default)s")
    add("--poses", type=int, default=1000, help="default: %(default)s")
    add("--map-rate", type=float, default=15.0, help="maps a second; default: %(default)g")
    add("--pose-rate", type=float, default=30.0, help="poses a second; default: %(default)g")
    add("--folder", type=Path, help="of the episodes; default: leap_rig/grasps in ROS's home, ~/.ros")
    add("--view", choices=("camera", "table"), help="what the network sees; default: as in ggcnn.yaml")
    options = parser.parse_args(rospy.myargv()[1:])
    for name in ("maps", "poses"):
        if not 1 <= getattr(options, name) <= 10000:
            parser.error(f"--{name} is {getattr(options, name)} and must be 1 to 10000.")
    for name in ("map-rate", "pose-rate"):
        if not 0.1 <= (rate := getattr(options, name.replace("-", "_"))) <= 100.0:
            parser.error(f"--{name} is {rate:g} and must be 0.1 to 100 a second.")
    run_program(NAME, lambda: _run(options), "Interrupted; the poses that are written stay.")


def _run(options: argparse.Namespace) -> None:
    join(NAME, anonymous=True)
    values = default_values()
    folder = "" if options.folder is None else str(options.folder.absolute())
    values.update(folder=folder, object=options.object, operator=options.operator)
    if options.view is not None:
        values["ggcnn"]["view"] = options.view
    setup = setup_from(values)
    session = ShownGrasp(options.maps, options.poses, options.map_rate, options.pose_rate)
    recorder = ShownGraspRecorder(setup, session)
    _phase(recorder, Phase.MAPS, options.maps, "maps at home", recorder.watch_images)
    print("Bring the hand to the grasp and keep it there; then press Enter. After a pause, Enter continues.")
    enters, taking = Enters(sys.stdin), False

    def take() -> None:
        nonlocal taking
        taking = (taking and recorder.following) or enters.pressed()
        if taking:
            recorder.take_pose()
        elif enters.ended:
            raise RigError("The poses start with Enter, but there is no keyboard; start the program in a terminal.")
        else:
            recorder.waits_for = "Enter starts"

    _phase(recorder, Phase.POSES, options.poses, "poses", take)
    print(f"{options.poses} poses of {options.object} with {options.maps} maps are in {setup.folder}.")


def _phase(recorder: ShownGraspRecorder, phase: Phase, total: int, name: str, step: Callable[[], None]) -> None:
    """Runs `step` until a phase is over, with a progress bar."""
    poll_s = 0.005
    # Refreshed at each poll, as it also shows why nothing is taken: only the rate since the start is right then.
    with tqdm(total=total, desc=name, miniters=0, smoothing=0) as bar:
        while recorder.session.phase is phase:
            if rospy.is_shutdown():
                raise RigError("ROS shut down; the poses that are written stay.")
            step()
            if recorder.session.phase is phase:
                bar.update(recorder.session.taken - bar.n)
            bar.set_postfix_str(recorder.waits_for, refresh=False)
            clock.sleep(poll_s)
        bar.update(total - bar.n)
