"""Numbers of the arm's teleoperation that a user or a reviewer must know; what a user may set is in config.py. Times
in seconds of a monotonic clock. The tuning of the filters is in hand_filter.py."""

from __future__ import annotations

import math
from typing import Final

from common.hand_tracking import LONG_GAP_SPEED_M_S
from common.numbers import FAR_TOOL_M, HAND_LOST_S, LEAST_RATE_HZ
from common.operator_rows import OLD_ROWS_S
from common.stream_pause import SENDER_PAUSE_S

# A hand is held still: start_gate.held_still.
STILL_SPEED_M_S: Final = LONG_GAP_SPEED_M_S  # a faster palm passes through the box and starts nothing
NOMINAL_RATE_HZ: Final = 110.0  # of the tracker
STILL_WINDOW_S: Final = 10.0 / NOMINAL_RATE_HZ  # time over which the speed is measured, whatever leap/buffer_size
STILL_SAMPLES: Final = 4  # fewest samples that have a speed

# A stream, and the hand that steers it.
MAX_SILENCE_S: Final = HAND_LOST_S  # longest time between two frames of one stream, or two frames with its hand
MAX_LEFT_OUT: Final = 5  # outliers in a row after which the hand counts as lost
MAX_HAND_DISTANCE_M: Final = 2.0  # of a palm from the Leap, whose documented range is 0.6 m
TURN_S: Final = 0.5  # how long a hand whose mean is full may start, before another hand in the box has its turn
MIN_RATE_HZ: Final = LEAST_RATE_HZ  # below this frame rate the tool stays
ENOUGH_RATE_HZ: Final = 24.0  # a tool that stayed moves again from here on: the controller then follows (at 22), too
MAX_HELD_TURN: Final = math.radians(10.0)  # farther, or by more than MAX_STEP_M, no tool moves when the rate is back
FADE_S: Final = 1.0  # in which the tilt of a hand that takes a held tool over takes full effect, or a program's pose
STATE_PERIOD_S: Final = 0.2  # longest time between two messages on leap_kuka/state
HEARTBEAT_S: Final = 0.5  # longest time without a report: leap_hand follows nobody when leap_kuka falls silent

# The controller.
PAUSE_S: Final = SENDER_PAUSE_S  # after such a pause it sees a new stream, else the arm would go on to the new hand
MAX_STATUS_AGE_S: Final = OLD_ROWS_S  # of its status, for a relative start
MEASURED_AGE_S: Final = 0.5  # of the measured tool, and how far its stamp may be off

# Whether the arm comes to a desired tool: asked before a start and while a stream runs.
REACH_LOOK_S: Final = 0.2  # while a stream runs: between two looks at the newest answer
REACH_RUNNING_S: Final = 3.0 * REACH_LOOK_S  # while a stream runs: between two questions to the controller
REACH_START_S: Final = 0.1  # between two questions before a start
REACH_TIMEOUT_S: Final = 0.5
REACH_FRESH_S: Final = 2.0  # older answers are ignored; longer than a question that times out, and two periods
REACH_NEAR_M: Final = 0.03  # at a start an answer about a tool farther away is ignored,
REACH_NEAR_RAD: Final = math.radians(10.0)  # or one turned by more

# A tool that an engagement leaves, or a program holds.
LOOK_PERIOD_S: Final = 0.05  # between two looks where the arm is while a stream runs
STOP_M: Final = 0.05  # an arm at full speed stops within this
BEHIND_M: Final = 0.15  # an arm that follows is no farther behind the desired tool
GLIDE_M_S: Final = 0.3  # so fast the kept tool comes nearer to the arm: the controller sees no jump
JUST_S: Final = 0.5  # an arm that brakes, since the hand jumped, was near so short a time ago,
MOVED_M: Final = 0.1  # and came so far
AT_HOME_M: Final = 0.03
MAX_HOLD_S: Final = 120.0
MAX_TOOL_DISTANCE_M: Final = FAR_TOOL_M  # from the base
LEAD_SILENCE_S: Final = HAND_LOST_S  # a program that steers is silent
LEAD_GONE_S: Final = 5.0  # a program that steers has left: it must be allowed anew
LEAD_NEAR_M: Final = 0.05  # a program's first pose is so near to where the tool is,
LEAD_NEAR_RAD: Final = math.radians(20.0)  # and turned by no more
MAX_TILT_DEG: Final = 50.0  # of a held tool against home, where it points down; 45 for a tilted grasp, and an error
AHEAD_M: Final = 0.1  # least distance in front of the base, nearer than the workspace; at most half of its centre's
ABOVE_M: Final = 1e-3  # least height over the foot; the workspace may end at the foot

# Hold-to-enable and clutch.
DEVICE_SILENCE_S: Final = 0.25  # a device has fallen silent
DEVICE_PERIOD_S: Final = 0.1  # longest time between two of its messages
DEVICE_POLL_S: Final = 0.01  # longest time until a debounced change is published
DEVICE_RETRY_S: Final = 1.0  # between two attempts to open it
LEFT_S: Final = 2.0  # one of several programs that has been silent for so long has left
JOY_SILENCE_S: Final = 0.5  # a gamepad that does not report for this long is lost
CLOSED: Final = 0.8  # grab or pinch strength from which the second hand is closed,
OPENED: Final = 0.5  # and up to which it is open
DEBOUNCE_S: Final = 0.1  # time for which it must be so before the tool may move
GAP_S: Final = 0.1  # a second hand out of view for longer has left
CLEARLY_M: Final = 0.03  # a hand that chooses an arm must be so far beyond the border between two regions

# The delay from the hand to the arm is measured with what comes on tf.
REST_S: Final = 0.5  # between two looks
READ_S: Final = 0.01  # for each
