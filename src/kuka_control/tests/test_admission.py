"""Whether a stream of desired tool frames counts, and what the status says otherwise: each row is a story on the
control loops, its last sentence, and whether the arm goes."""

from __future__ import annotations

import pytest
from loop_world import DT, World, at_rate, block, shifted

from kuka_control.limits.collision import PathCheck
from kuka_control.model.config import PtpConfig, RealTimeConfig

NEAR = shifted(0.05, 0.0, 0.05)
FAR = shifted(0.0, 0.25, 0.2)
BOTH_PUBLISH = "Both /a and /b publish it."
BARRED = "The desired tool frame moved before control was switched on and does not count: take the hand out of the box"
HAND_ANEW = "The desired tool frame does not count until it begins anew: take the hand out of the box"
PAUSE_ANEW = "The desired tool frame counts again after a pause of 2 s."
BY_MOVE = "The desired tool frame began to move while a program moved the arm."
OFF = "Control is off, so the desired tool frame is not followed."
TAKEN_OVER = "The desired tool frame came before control was switched on; 1 s after it is announced the arm goes there"
TOO_FAR = "is 320 mm and 0 deg from the tool at home, but the arm takes it over only within 300 mm and 45 deg"
IN_THE_WAY = "The collision guard refuses the motion to"
WAITS = "The arm repeats a motion that nobody asked for only after 10 s"
SILENT = "No desired tool frame comes."
OLD = "its stamp is 1.000 s behind this machine's clock"
SLOW = "The desired tool frame comes only every 0.25 s, but time_out is 0.2 s"
RARE = "Hz, but the arm follows it only from 22 Hz on"
GOES = ""  # no refusal: the arm goes there


class Story(World):
    """A world whose operator acts by the words of a row; "hand 1" and "node 1" are frames for a second."""

    def play(self, story):
        for act in story.split(", "):
            what, _, seconds = act.partition(" ")
            if what in ("hand", "node"):
                self.foreign = what == "node"
                self.run(float(seconds), self.place)
            elif what == "pause":
                self.run(float(seconds))
            elif what == "rare":
                at_rate(self, 15.0, lambda _: self.place, float(seconds))
            elif what == "seldom":
                at_rate(self, 4.0, lambda _: self.place, float(seconds))
            else:
                getattr(self, "do_" + what)()
        return self

    place = NEAR

    def do_on(self):
        self.control_on = True

    def do_off(self):
        self.control_on = False

    def do_again(self):
        """Control is switched off and on."""
        self.control_on = False
        self.run(DT)
        self.control_on = True

    def do_far(self):
        self.place = FAR

    def do_near(self):
        self.place = NEAR

    def do_conflict(self):
        self.conflict = BOTH_PUBLISH

    def do_peace(self):
        self.conflict = None

    def do_skewed(self):
        self.skew = -1.0

    def do_true(self):
        self.skew = 0.0

    def do_program(self):
        self.ask("aside")

    def do_blocked(self):
        block(self)

    def do_nodes(self):
        self.foreign = True

    def do_engages(self):
        self.engagement = 1 + (self.engagement or 0)

    @property
    def refusal(self):
        """What the status says after the sentence of the state, if no frame is followed."""
        return self.steps[-1].reason if self.steps[-1].inhibited else GOES


ROWS = {
    # A stream that begins while control is on counts.
    "a hand that comes": ("on, hand 0.3", GOES, True),
    "a far node that comes": ("on, far, node 0.3", GOES, True),
    # One that ran before does not, unless no hand brings it and it is near.
    "a hand from before": ("hand 0.5, on, hand 3", BARRED, False),
    "it comes anew": ("hand 0.5, on, hand 0.5, pause 0.3, hand 1", GOES, True),
    "it comes anew too soon": ("hand 0.5, on, hand 0.5, pause 0.2, hand 1", BARRED, False),
    "it pauses": ("hand 0.5, on, hand 0.5, pause 0.4", GOES, False),
    "a hand that went just before": ("hand 0.5, pause 0.25, on, hand 1", BARRED, False),
    "a hand that went before": ("hand 0.5, pause 0.4, on, hand 1", GOES, True),
    "a near node from before": ("node 0.5, on, node 0.9", TAKEN_OVER, False),
    "it is taken over": ("node 0.5, on, node 2", GOES, True),
    "it lags when control is switched on": ("node 0.5, pause 1.9, on, node 0.9", TAKEN_OVER, False),
    "it was away when control was switched on": ("node 0.5, pause 2.1, on, node 0.5", GOES, True),
    "it pauses after the announcement": ("node 0.5, on, node 0.9, pause 0.4, node 0.9", TAKEN_OVER, False),
    "nothing is announced in a pause": ("node 0.5, on, node 0.5, pause 0.4", GOES, False),
    "a far node from before": ("far, node 0.5, on, node 3", TOO_FAR, False),
    "it comes nearer by itself": ("far, node 0.5, on, node 0.5, near, node 3", TOO_FAR, False),
    "it goes far after the announcement": ("node 0.5, on, node 0.5, far, node 3", TOO_FAR, False),
    "a far one pauses shortly": ("far, node 0.5, on, node 0.5, pause 1.9, near, node 3", TOO_FAR, False),
    "a far one pauses long": ("far, node 0.5, on, node 0.5, pause 2.1, near, node 0.5", GOES, True),
    "control is switched on again": ("far, node 0.5, on, node 0.5, near, again, node 0.9", TAKEN_OVER, False),
    "a hand in an announced stream": ("node 0.5, on, node 0.5, hand 3", BARRED, False),
    # A conflict, and a program's motion.
    "two publishers": ("on, conflict, hand 1, peace, hand 1", f"{BOTH_PUBLISH} {HAND_ANEW}", False),
    "two foreign publishers": ("on, conflict, node 1, peace, node 1", f"{BOTH_PUBLISH} {PAUSE_ANEW}", False),
    "two publishers are shown as such": ("on, conflict, hand 0.3", BOTH_PUBLISH, False),
    "two publishers, then a new hand": ("on, conflict, hand 1, peace, pause 0.4, hand 1", GOES, True),
    "two publishers before control is switched on": ("conflict, hand 0.5, on, hand 0.5, peace, hand 1", BARRED, False),
    "two publishers of an announced stream": (
        "node 0.5, on, node 0.5, conflict, node 0.5, peace, node 3",
        f"{BOTH_PUBLISH} {PAUSE_ANEW}",
        False,
    ),
    "two publishers of a barred stream": (
        "hand 0.5, on, hand 0.5, conflict, hand 0.5, peace, hand 1",
        f"{BOTH_PUBLISH} {HAND_ANEW}",
        False,
    ),
    "control is switched on after two publishers": (
        "on, conflict, hand 0.5, peace, hand 0.5, again, hand 1",
        BARRED,
        False,
    ),
    "a hand during a program's motion": ("on, program, pause 0.1, hand 3", f"{BY_MOVE} {HAND_ANEW}", False),
    "it comes anew afterwards": ("on, program, pause 0.1, hand 1, pause 2, hand 1", GOES, True),
    "a node during a program's motion": ("on, program, pause 0.1, node 3", f"{BY_MOVE} {PAUSE_ANEW}", False),
    "a lagging node during a program's motion": (
        "node 0.5, pause 0.4, on, program, pause 0.1, node 4",
        f"{BY_MOVE} {PAUSE_ANEW}",
        False,
    ),
    "a hand for a lagging node during the motion": (
        "node 0.5, pause 0.4, on, program, pause 0.1, node 1, hand 2",
        BARRED,
        False,
    ),
    # What else keeps the arm, in order of precedence.
    "old frames": ("on, skewed, hand 1", OLD, False),
    "old frames of a barred stream": ("hand 0.5, on, hand 0.5, skewed, hand 0.5", OLD, False),
    "a barred stream that was old": ("hand 0.5, on, hand 0.3, skewed, hand 0.2, true, hand 0.1", BARRED, False),
    "old frames of an announced stream": ("node 0.5, on, node 0.5, skewed, node 0.5", OLD, False),
    "a refusal outlives its frames": ("on, skewed, hand 0.5, pause 0.45", OLD, False),
    "a refusal ends": ("on, skewed, hand 0.5, pause 0.55", GOES, False),
    "frames that are too slow": ("on, seldom 3", SLOW, False),
    "slow frames of a barred stream": ("hand 0.5, on, hand 0.2, seldom 3", BARRED, False),
    "slow frames of a node from before": ("nodes, seldom 2, on, seldom 3", SLOW, False),
    "slow frames of a far node from before": ("far, nodes, seldom 2, on, seldom 3", SLOW, False),
    "slow frames of an announced stream": ("node 0.5, on, node 0.5, seldom 2.5", SLOW, False),
    "control off": ("hand 0.5", OFF, False),
    "control off, no frame": ("hand 0.5, pause 0.4", GOES, False),
    "control off again": ("hand 0.5, on, hand 0.5, off, hand 0.5", OFF, False),
    "a body in the way": ("blocked, on, hand 1", IN_THE_WAY, False),
    "a body in the way of a barred stream": ("blocked, hand 0.5, on, hand 1", BARRED, False),
    "a body in the way of an announced stream": ("blocked, node 0.5, on, node 2", TAKEN_OVER, False),
    "a body in the way, and the frames end": ("blocked, on, hand 1, pause 0.5", GOES, False),
    "a repetition": ("on, nodes, node 1.5, pause 2.5, node 1", WAITS, False),
    "a repetition, and control on again": ("on, nodes, node 1.5, pause 2.5, node 1, again, node 2.5", GOES, True),
    "a repetition, and the frames end": ("on, nodes, node 1.5, pause 2.5, node 1, pause 0.2", GOES, False),
    "a hand has one repetition free": ("on, hand 1.5, pause 1.2, hand 1.5, pause 1.2, hand 1", WAITS, False),
    "another hand": ("on, hand 1.5, pause 1.2, hand 1.5, pause 1.2, hand 0.5, engages, hand 2", GOES, True),
    "a repetition that is old, too": ("on, nodes, node 1.5, pause 2.5, node 1, skewed, node 0.1", OLD, False),
}

SERVO_ROWS = {
    "a hand": ("on, hand 2", GOES),
    "no frames": ("on, hand 2, pause 0.4", SILENT),
    "a short pause": ("on, hand 2, pause 0.2", GOES),
    "rare frames": ("on, hand 2, rare 1", RARE),
    "rare frames that end": ("on, hand 2, rare 1, pause 0.4", SILENT),
    "rare frames that are old, too": ("on, hand 2, rare 1, skewed, hand 0.1", OLD),
    "old frames that end": ("on, hand 2, skewed, hand 0.1, pause 0.4", OLD),
    "frequent frames again": ("on, hand 2, rare 1, hand 1", GOES),
    "rare frames of a stay before": ("on, hand 2, rare 1, pause 12, hand 2", GOES),
    "two publishers": ("on, hand 2, conflict, hand 0.1, peace, hand 1", f"{BOTH_PUBLISH} {HAND_ANEW}"),
}
"""The same in servo mode, with a time-out of 1 s."""

OUTLOOKS = {
    "no frame": ("pause 1", None),
    "a hand": ("hand 0.5", BARRED),
    "a hand that went": ("hand 0.5, pause 0.4", None),
    "a node": ("node 0.5", TAKEN_OVER),
    "a far node": ("far, node 0.5", TOO_FAR),
    "a slow node": ("nodes, seldom 2", SLOW),
    "a slow, far node": ("far, nodes, seldom 2", SLOW),
    "a slow hand": ("seldom 2", BARRED),
    "old frames": ("node 0.5, skewed, node 0.5", OLD),
    "old frames of a hand": ("skewed, hand 0.5", OLD),
    "a pause": ("node 0.5, pause 0.2", TAKEN_OVER),
    "control on": ("node 0.5, on, node 0.1", None),
    "control off again": ("node 0.5, on, node 0.1, off, node 0.1", TAKEN_OVER),
    "rare frames": ("nodes, rare 2", TAKEN_OVER),
}
"""What happens to the present frame once control is switched on."""


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@pytest.mark.parametrize("row", ROWS)
def test_whether_a_stream_counts(schema, row):
    story, sentence, goes = ROWS[row]
    world = Story(schema, collision_guard="blocked" in story).at_home().play(story)
    assert sentence in world.refusal and bool(sentence) == bool(world.refusal)
    assert goes == (world.mode not in ("home", "holding", "moving")), world.mode


@pytest.mark.parametrize("row", SERVO_ROWS)
def test_what_keeps_an_arm_that_follows(row):
    story, sentence = SERVO_ROWS[row]
    world = Story(time_out=1.0).at_home().play(story)
    assert sentence in world.refusal and bool(sentence) == bool(world.refusal)
    assert world.mode == ("stopped" if "conflict" in story else "servo")


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@pytest.mark.parametrize("row", OUTLOOKS)
def test_what_happens_once_control_is_switched_on(schema, row):
    story, sentence = OUTLOOKS[row]
    outlook = Story(schema).at_home().play(story).loop.when_enabled
    assert outlook is None if sentence is None else sentence in outlook
    if row == "rare frames":
        assert (RARE in outlook) == (schema is RealTimeConfig)


@pytest.mark.parametrize("schema", [RealTimeConfig, PtpConfig])
@pytest.mark.parametrize("begins", ["hand", "node", "announced"])
def test_a_way_that_is_checked_meanwhile_starts_no_motion_once_control_was_off(schema, begins):
    world = Story(schema, collision_guard=True).at_home()
    checks = []
    guard = world.loop._settings.guard
    guard.check = lambda *_: checks.append(PathCheck(iter([None] * 1000))) or checks[-1]
    world.play("node 0.5, on" if begins == "announced" else "on")
    world.foreign = begins != "hand"
    while not checks:
        world.run(DT, NEAR)
    assert not checks[0].done
    world.control_on = False
    world.control_on = True  # between two cycles; no frame comes before the check would be over
    world.run(0.1)
    assert world.mode == "home" and not world.arm.commands
