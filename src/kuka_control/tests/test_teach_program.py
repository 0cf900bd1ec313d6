"""The program teach.py and the hand guiding of kuka/move; in virtual time, with a hand that moves the arm by steps."""

from __future__ import annotations

import argparse
import contextlib
from dataclasses import replace

import numpy as np
import pytest
from loop_world import HOME

from common import clock
from common.errors import RigError
from common.modes import Mode
from iiwa_kinematics.robot_model import robot_model

pytest.importorskip("kuka_msgs.msg")
import rospy

from kuka_control.loop.commands import Step, Wait
from kuka_control.loop.moves import MoveProgress, MoveState
from kuka_control.model.taught import TaughtArm
from kuka_control.ros import teach_program
from kuka_control.ros.moves import MoveServer

pytestmark = pytest.mark.ros
ARM = TaughtArm("LBR7R800", "MF_elektrisch", "")
HELD_S = 0.5  # the hand holds the enabling switch for so long each time
STEP = np.array([0.2, -0.1, 0.1, 0.0, 0.0, 0.1, 0.0])


class GuidedArm:
    """A controller whose arm a hand moves by STEP each time, or that is sent where a program asks."""

    def __init__(self, **options):
        self.q, self.asked, self.mode = HOME.q.copy(), [], Mode.HOME
        self._step = Step(Wait(), Mode.HOME, "The arm is at home.", ())
        self.server = MoveServer(self, lambda: (self._step, self.q), stops=True, **options)

    def plan(self, number, goal, q):
        from kuka_control.loop.moves import ProgramMotion

        return ProgramMotion(number, "the joints", goal.target, goal.velocity)

    def run(self):
        begun, number = 0.0, 0
        while not rospy.is_shutdown():
            move, now, progress = self.server.move, clock.monotonic(), None
            if move is not None:
                if move.number != number:
                    begun, number, start = now, move.number, self.q
                    self.asked.append(move)
                share = min((now - begun) / HELD_S, 1.0)
                self.q = start + share * (STEP if move.guided else move.q - start)
                ended = MoveState.CANCELLED if move.cancelled else MoveState.DONE if share == 1.0 else MoveState.RUNNING
                progress = MoveProgress(number, ended, "So it ended.")
            self._step = Step(Wait(), self.mode, "So it is.", (), move=progress)
            self.server.show(self._step, self.q)
            clock.sleep(0.02)


@pytest.fixture
def guided(virtual_graph, monkeypatch, tmp_path):
    """Starts the controller; a test may pass options of its MoveServer."""
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setattr(teach_program, "join", lambda *_, **__: None)
    monkeypatch.setattr(teach_program, "_arm", lambda: (ARM, robot_model(ARM.robot, ARM.flange)))

    def start(**options):
        made = []

        def main():
            rospy.init_node("controller")
            made.append(GuidedArm(**options))
            made[0].run()

        virtual_graph.start("controller", main)
        virtual_graph.wait_until(lambda: made, 10.0, "the controller")
        return made[0]

    return start


def interrupted_after(monkeypatch, seconds):
    @contextlib.contextmanager
    def noted():
        end = clock.monotonic() + seconds

        class Noted(list):
            def __bool__(self):
                return clock.monotonic() > end

        yield Noted()

    monkeypatch.setattr(teach_program, "noted_interruptions", noted)


def record(**options):
    return teach_program._record(argparse.Namespace(**{"name": "wave", "path": False, "replace": False, **options}))


def stored():
    return teach_program._read(teach_program.user_file(teach_program.KIND, "wave"), *teach_program._arm())


def test_each_release_keeps_a_way_point_and_they_are_played_back(guided, monkeypatch, capsys):
    arm = guided(unguided=None)
    interrupted_after(monkeypatch, 3.5 * HELD_S)
    assert record() == 0 and arm.server.move is None
    np.testing.assert_allclose(stored(), HOME.q + np.outer(range(1, len(stored()) + 1), STEP), atol=1e-9)
    said = capsys.readouterr().out
    assert len(stored()) == 3 and said.count("Hold the enabling switch") == 1 and "wave.yaml has 3 way points." in said
    with pytest.raises(RigError, match="wave.yaml exists"):
        record()
    arm.asked.clear()
    from kuka_control.ros import move_program

    monkeypatch.setattr(move_program, "noted_interruptions", lambda: contextlib.nullcontext([]))
    assert teach_program._play(argparse.Namespace(name="wave", velocity=0.1)) == 0
    np.testing.assert_allclose([move.q for move in arm.asked], stored())
    assert {move.velocity for move in arm.asked} == {0.1}
    assert teach_program._list(argparse.Namespace()) == 0
    assert "wave" in capsys.readouterr().out


def test_a_path_keeps_the_way_between(guided, monkeypatch):
    guided(unguided=None)
    interrupted_after(monkeypatch, 1.5 * HELD_S)
    assert record(path=True) == 0
    np.testing.assert_allclose(stored()[-1], HOME.q + 1.5 * STEP, atol=0.25)
    assert len(stored()) < 5, "the way was straight"


def test_an_arm_that_cannot_be_guided_says_why_and_nothing_is_stored(guided, monkeypatch, capsys):
    guided()
    interrupted_after(monkeypatch, 10.0)
    with pytest.raises(RigError, match="No way point was kept. Hand guiding is refused: robot_server is toolbox"):
        record()
    assert not capsys.readouterr().out, "nobody is asked to move an arm that cannot be moved"
    assert not teach_program.user_file(teach_program.KIND, "wave").exists()


def test_nobody_is_asked_to_move_an_arm_whose_robot_refuses_it(guided, monkeypatch, capsys):
    arm = guided(unguided=None)
    interrupted_after(monkeypatch, 10.0)
    show, begun = arm.server.show, []

    def refused(step, joints):
        if step.move is not None:
            begun.append(clock.monotonic())
            state = MoveState.ABORTED if begun[-1] - begun[0] > 0.1 else MoveState.RUNNING
            progress = MoveProgress(step.move.number, state, "The robot refused it.")
            step = replace(step, move=progress, transitions=("begun",) if len(begun) == 1 else ())
        show(step, joints)

    monkeypatch.setattr(arm.server, "show", refused)
    with pytest.raises(RigError, match="No way point was kept. The robot refused it."):
        record()
    assert not capsys.readouterr().out


def test_what_cannot_be_stored_is_said_before_or_shown(guided, monkeypatch, capsys):
    arm = guided(unguided=None)
    assert teach_program._list(argparse.Namespace()) == 0 and "No motion is kept in " in capsys.readouterr().out
    folder = teach_program.user_file(teach_program.KIND, "wave").parent
    with monkeypatch.context() as patched:
        patched.setattr(teach_program.os, "access", lambda *_: False)
        with pytest.raises(RigError, match="taught_motions cannot be written; nothing could be stored"):
            record()
    folder.rmdir()
    folder.write_text("a file")
    with pytest.raises(RigError, match="taught_motions cannot be made: File exists; nothing could be stored"):
        record()
    assert not arm.asked, "nobody moves the arm for nothing"
    folder.unlink()

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(teach_program, "write_whole", full)
    interrupted_after(monkeypatch, 1.5 * HELD_S)
    with pytest.raises(RigError, match="wave.yaml cannot be written: No space left on device"):
        record()
    shown = capsys.readouterr().out
    folder.joinpath("wave.yaml").write_text(shown[shown.index("1 way point kept.") + len("1 way point kept.") :])
    assert len(stored()) == 1, "what is shown can be stored by hand"


def test_a_controller_that_falls_silent_ends_the_recording_and_what_was_kept_is_stored(guided, monkeypatch, capsys):
    arm = guided(unguided=None)
    interrupted_after(monkeypatch, 60.0)
    show = arm.server.show

    def silent(step, joints):
        if len(arm.asked) < 3:
            show(step, joints)

    monkeypatch.setattr(arm.server, "show", silent)
    assert record() == 1 and len(stored()) == 2
    assert "has reported nothing for 5 s" in capsys.readouterr().err


def test_the_service_guides_and_ends_it_and_another_motion_waits(guided, monkeypatch):
    arm = guided(unguided=None)
    server = arm.server
    assert server.guide(True).success and server.guided
    refused = server.guide(True)
    assert not refused.success and "The motion before has not ended" in refused.message
    assert server.guide(False).success
    clock.sleep(0.1)
    assert not server.guided and arm.asked[0].guided
    arm.mode = Mode.SERVO
    clock.sleep(0.1)
    refused = server.guide(True)
    assert not refused.success and "the mode is servo" in refused.message
    arm.mode = Mode.HOME
    clock.sleep(0.1)
    monkeypatch.setattr(server, "show", lambda *_: clock.sleep(3600.0))
    refused = server.guide(True)
    assert not refused.success and "has done nothing for 2 s" in refused.message and server.move.cancelled
