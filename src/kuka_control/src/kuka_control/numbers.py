"""Numbers of the arm's controller that a user or a reviewer must know; what a user may set is in model/config.py.
Times in seconds of a monotonic clock. The tuning of a single calculation stands beside it. A doubled time fails a
test (tests/test_time_constants.py)."""

from __future__ import annotations

import math
from typing import Final

from common.numbers import FAR_TOOL_M, LEAST_RATE_HZ, STAMP_SKEW_S

# A link to the robot that falls silent. TCP repeats a lost packet after 0.2 s, and after 0.4 s more.
NAMED_S: Final = 0.12  # beyond the link's usual delay: then it is said; with a cycle's wait within 0.2 s
OFF_S: Final = 1.0  # in servo mode control is switched off then; outside of it after twice that: no goals depend on it
MAX_MISSED: Final = 5  # so many missing or unusable answers in a row end the link, if they took MISSING_S at least
MISSING_S: Final = 3.0  # a busy machine is late several times in a row
FIRST_PAUSE_S: Final = 0.5  # before a lost robot is tried again; the pause doubles up to LONGEST_PAUSE_S
LONGEST_PAUSE_S: Final = 5.0
PROBE_S: Final = 12.0  # longest wait for a robot that answers nonsense; the client gives a silent one up before
TIMEOUT_S: Final = 5.0  # of a connection at the start, and of its first answer
AGAIN_TIMEOUT_S: Final = 2.0  # of a try to connect again, likewise
BRAKING_S: Final = 1.0  # an arm that follows a hand when ROS shuts down has this long to brake

ENABLING_SILENT_S: Final = 0.5  # an operator who enabled, and of whom nothing is heard for so long, has let go

# Whether the arm follows its goals. A safety stop shows within half a second.
FAR_RAD: Final = math.radians(20.0)  # goal and joint are too far apart; full speed lags about half of it behind
FAR_S: Final = 0.1  # how long they may be
STILL_S: Final = 0.3  # how long the arm may stand still away from its goal
UNKNOWN_S: Final = 0.5  # so long at most are goals sent that lie away from the last known joints
HELD_S: Final = 0.4  # an arm in a PTP motion that came no nearer for this time is held (reduced override is slow)
HELD_AT_ENDS_S: Final = 1.0  # the same at the ends of a motion: brakes open, it starts and stops gently
HELD_AT_GOAL_S: Final = 2.0  # the same at the goal: after a lost answer the client takes 1 s to tell the end by joints
FASTER: Final = 1.2  # joints that change faster than this fraction of their full speed are not believed
LAST_GOALS_S: Final = 0.2  # the arm may still be on its way between the goals of this time before a reading

# Whether the desired tool frame counts. Its pauses: common/stream_pause.py.
MAX_DISTANCE_M: Final = FAR_TOOL_M  # of the tool from the base
MAX_SKEW_S: Final = STAMP_SKEW_S  # how far a stamp may be from the clock
MAX_OFFSET_S: Final = 60.0  # a clock that differs by more was never set, and a stamp that does is of a recording
HANDOVER_S: Final = 1.0  # another node may take over a frame after the one before has been silent for this long
PAUSE_PERIODS: Final = 2.5  # a pause before a new stream also is longer than so many times the time between its frames
FOREIGN_PAUSE_S: Final = 2.0  # no hand comes in with a foreign frame: a shorter pause begins no new stream
STALLED_S: Final = 0.5  # stalls of the loop count as silence where they are longer than this together
REFUSING_S: Final = 0.5  # frames count as refused until this long after the last refused one
STANDS_S: Final = 0.5  # ROS time that has not passed for this long stands still
UNCONNECTED_S: Final = 0.5  # so long the transforms of a chain may come one after the other
REPEATED_S: Final = 0.3  # so long a stamp may come again and again

# How the arm follows it.
TOLERANCE_M: Final = 0.017  # of a frame's step on top of the speed limits: 2 deg of a joint, half a metre away
LOST_S: Final = 0.1  # after a longer gap than this the signal counts as lost and found again
LONGEST_STALL_S: Final = 0.5  # frames that came in a longer stall of the control loop than this do not count
FULL_SPEED_HZ: Final = 60.0  # the tool moves at most 11 mm a frame at 0.65 m/s; at lower rates no further
HOLD_HZ: Final = LEAST_RATE_HZ  # frames that come less often than this are not followed
RESUME_HZ: Final = 22.0  # frames that were not are followed again from this rate on; leap_kuka lets a hand steer at 24
CONTINUED_S: Final = 0.03  # a frame is continued for 1.5 times the time between frames, at most for this long
FADE_S: Final = 0.02  # a target that is not continued any more slows down to rest in this time
ANNOUNCED_S: Final = 1.0  # a stream that ran already is taken over so long after that was announced
NEAR_M: Final = 0.3  # and only if it is not farther from the tool at home
NEAR_RAD: Final = math.radians(45.0)  # nor turned further
AGAIN_S: Final = 10.0  # a PTP motion that nobody asked for is not repeated within this time

# What else the loop waits for.
HAND_S: Final = 1.0  # at the start: for the first report of the hand
BLOCKED_S: Final = 0.25  # a pick-up motion that the collision guard refused is checked again after this time
EXIT_PATIENCE_S: Final = 2.0  # on exit: for an arm that something holds
PROGRESS_S: Final = 0.02  # how far the plan of a line must come in NO_PROGRESS_S, or the line ends
NO_PROGRESS_S: Final = 2.0
LINE_START_RAD: Final = 2e-3  # a line begins where the arm stands; no joint is further off than this
TEST_MOTIONS: Final = 3  # of joint 7 at most, to show the servo law, where a busy machine did not see it well

# How slowly a program may ask for a motion: the toolbox cannot stop a PTP motion, and a slower one looks stopped.
LEAST_PTP: Final = 0.01  # of the full joint speed
LEAST_LINE_M_PER_S: Final = 0.005

# The stream of goals.
SPEED_MARGIN: Final = 0.97  # the arm's speed is checked at some times only; between them it is up to 2.5 % faster
GAP_S: Final = 0.03
"""After a longer gap than this between two goals the arm starts from rest at the last one.

The simulated arm has lost half of its speed 20 to 55 ms after its last goal, with either servo law. Goals that continue
at full speed after 50 ms make a tool of 0.4 m/s exceed 0.8 m/s, at which the robot's controller stops it."""
SLACK_M: Final = 1e-3  # the path to a stop may lead this far out of the workspace: at curved bounds it is straight

# The admittance.
FORCE_OLD_S: Final = 0.1  # a force older than this is not known; the toolbox tells one every 0.04 s in servo mode
FORCE_AGAIN_S: Final = 0.3  # and counts again once none was unknown for so long: with gaps the tool would swing
FORCE_MOST_N: Final = 1e4  # a greater one cannot be true
FORCE_DELAY_S: Final = 0.12  # from a displacement until the force that comes of it is known, at most: 0.04 s between
# forces, 0.02 s between frames, the lag of the limited goals, of the drives, and of the link

# The collision guard; what each distance means: docs/handbook/collision-guard.md.
APPROACH_M_S2: Final = 2.0  # deceleration with which an approach is planned; the jerk limit and the wrist allow more
SOFT_M: Final = 0.003  # an approach ends so far before the margin, so that the tool can slide there
SAMPLED_M: Final = 0.001  # points of a path keep the margin with this on top: it bends between them
ARM_M: Final = 0.0025  # and points of the path of the arm with this, whose lag is known less exactly
LAG_S: Final = 0.027  # time constant with which a joint of the arm follows its goals, for drives of 40 ms

# What the operator sets.
SCALING_MIN: Final = 0.1
SCALING_MAX: Final = 1.5
SCALING_DEFAULT: Final = 1.0
PAYLOAD_MAX_KG: Final = 5.0
