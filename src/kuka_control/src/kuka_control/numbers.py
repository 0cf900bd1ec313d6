"""Numbers of the arm's controller that a user or a reviewer must know; what a user may set is in model/config.py.

Times in seconds of a monotonic clock. The tuning of a single calculation stands beside it.
"""

from __future__ import annotations

from typing import Final

# The link to the robot.
NAMED_S: Final = 0.12
"""A robot that has not answered for this long, beyond the link's usual delay, is reported; with a cycle's wait within
0.2 s [s]."""
OFF_S: Final = 1.0
"""A longer silence in servo mode switches control off [s]: TCP repeats a lost packet after 0.2 s, and after 0.4 s more.
Outside of servo mode it is twice as long: one answer is waited for that long, and no goals depend on it."""
MAX_MISSED: Final = 5  # this many missing or unusable answers in a row,
MISSING_S: Final = 3.0  # over this time at least, end the link: a busy machine is late several times in a row [s]
FIRST_PAUSE_S: Final = 0.5
LONGEST_PAUSE_S: Final = 5.0  # the pause between attempts doubles up to this [s]
PROBE_S: Final = 12.0  # the client gives a silent server up before; this bounds the wait for one that answers nonsense [s]
TIMEOUT_S: Final = 5.0
AGAIN_TIMEOUT_S: Final = 2.0  # how long a try to connect again waits for the connection, and again for the first answer [s]
BRAKING_S: Final = 1.0  # an arm that follows a hand when ROS shuts down has this long to brake [s]

# Whether the arm does what it is told.
FAR_S: Final = 0.1  # how long it may be too far [s]
STILL_S: Final = 0.3  # how long the arm may stand still away from its goal [s]; a safety stop shows within half a second
SAMPLES: Final = 10  # a verdict needs more measurements than this, so that a stall of the loop is not blamed on the arm
UNKNOWN_S: Final = 0.5  # so long at most are goals sent that lie away from the last known joints [s]
HELD_S: Final = 0.4  # an arm that came no nearer for this time is held; longer than in servo mode: reduced override [s]
HELD_AT_ENDS_S: Final = 1.0
"""The same before the arm has begun to move and in the last AWAY_RAD: the controller plans, opens the brakes, and
starts and stops gently, the more so at a reduced override [s]."""
HELD_AT_GOAL_S: Final = 2.0  # the same there: where an answer was lost, the client takes 1 s to tell the end by the joints [s]
FASTER: Final = 1.2  # joints that change faster than this fraction of their full speed are not believed
LAST_GOALS_S: Final = 0.2  # the arm may still be on its way between the goals of this time before a reading [s]

# Whether the desired tool frame counts.
MAX_DISTANCE_M: Final = 5.0  # a tool further from the base than this was not meant in metres [m]
HANDOVER_S: Final = 1.0  # another node may take over a frame after the one before has been silent for this long [s]
MAX_SKEW_S: Final = 0.5  # how far a stamp may be from the clock [s]
MAX_OFFSET_S: Final = 60.0  # a clock that differs by more was never set, and a stamp that does is of a recording [s]
PAUSE_PERIODS: Final = 2.5  # a pause before a new stream also is longer than so many times the time between its last frames
FOREIGN_PAUSE_S: Final = 2.0  # no hand comes in with a foreign frame: a pause that is shorter begins no stream [s]
STALLED_S: Final = 0.5  # stalls since the last frame count as silence where they are longer than this together [s]
REFUSING_S: Final = 0.5  # frames count as refused until this long after the last refused one [s]
STANDS_S: Final = 0.5  # ROS time that has not passed for this long stands still [s]
UNCONNECTED_S: Final = 0.5  # so long the transforms of a chain may come one after the other [s]
REPEATED_S: Final = 0.3  # so long a stamp may come again and again [s]

# When the arm follows it, and how.
TOLERANCE_M: Final = 0.017  # tolerance of the frame's step on top of the speed limits: 2 deg of a joint, half a metre away [m]
LOST_S: Final = 0.1  # after a longer gap than this the signal counts as lost and found again [s]
LONGEST_STALL_S: Final = 0.5  # frames that came in a longer stall of the control loop than this do not count [s]
FULL_SPEED_HZ: Final = 60.0  # the tool moves at most 11 mm from one frame to the next at 0.65 m/s; at lower rates no further
HOLD_HZ: Final = 20.0  # frames that come less often than this are not followed
RESUME_HZ: Final = 22.0  # until they come this often
CONTINUED_S: Final = 0.03  # a frame is continued for 1.5 times the time between frames, but at most for this long [s]
FADE_S: Final = 0.02  # then the target slows down to rest in this time [s]
ANNOUNCED_S: Final = 1.0  # a stream that ran already is taken over so long after that was announced [s]
EXIT_PATIENCE_S: Final = 2.0  # on exit, wait at most this long for an arm that something holds [s]
HAND_S: Final = 1.0  # at the start the arm waits so long for the first report of the hand [s]
BLOCKED_S: Final = 0.25  # a pick-up motion that the collision guard refused is checked again after this time [s]
LINE_START_RAD: Final = 2e-3  # a line begins where the arm stands; no joint is further off than this
NO_PROGRESS_S: Final = 2.0  # in this time does not continue [s]

# The stream of goals.
SPEED_MARGIN: Final = 0.97  # the guard checks the speed of the arm at some times only; between them it is up to 2.5 % faster
TEST_MOTIONS: Final = 3
"""So often at most does joint 7 turn to show the servo law, where a busy machine did not see it well."""
GAP_S: Final = 0.03
"""After a longer gap than this between two goals the arm starts from rest at the last one [s].

The simulated arm has lost half of its speed 20 to 55 ms after its last goal, with either servo law. Goals that continue
at full speed after 50 ms make a tool of 0.4 m/s exceed 0.8 m/s, at which the robot's controller stops it."""
SLACK_M: Final = 1e-3  # the path to a stop may lead out of the workspace by this much: at curved bounds it is straight [m]
NEAR_LIMIT: Final = 0.85  # a speed above this fraction of the limit is checked at more of them:
QUICK: Final = 0.999  # fraction of the speed limit up to which an upper bound of the speed replaces that check

# The collision guard.
APPROACH_M_S2: Final = 2.0  # deceleration with which an approach is planned [m/s^2]; the jerk limit and the wrist allow more
SOFT_M: Final = 0.003  # an approach ends so far before the margin, so that the tool can slide there [m]
SAMPLED_M: Final = 0.001  # points of a path keep the margin with this on top: it bends between them [m]
ARM_M: Final = 0.0025  # and points of the path of the arm with this, whose lag is known less exactly [m]
LAG_S: Final = 0.027  # time constant with which a joint of the arm follows its goals, for drives of 40 ms [s]

# What the operator sets.
SCALING_MIN: Final = 0.1
SCALING_MAX: Final = 1.5
SCALING_DEFAULT: Final = 1.0
PAYLOAD_MAX_KG: Final = 5.0
