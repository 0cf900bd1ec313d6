"""The only input of a controller: the tf transform to the desired tool frame, from any node, through any chain."""

from __future__ import annotations

import contextlib
import math
import struct

import numpy as np
import rospy
import tf2_ros
from geometry_msgs.msg import Transform
from tf2_msgs.msg import TFMessage

from common import clock
from common.frames import (
    BASE,
    FLANGE,
    FLANGE_DESIRED,
    FLANGE_HOME,
    FLANGE_MEASURED,
    FLANGE_SEEN,
    HAND_FILTERED,
    ONE_ARM,
    TOOL_COMMANDED,
    TOOL_DESIRED,
    TOOL_HOME,
    TOOL_MEASURED,
    VIRTUAL_LEAP,
    ArmFrames,
    frame_name,
)
from common.ros.conversions import pose_from_transform
from common.ros.raw_tf import RawTfMessage, RawTransform, publisher_of
from kuka_control.model.desired_frame import (
    ABSENT_S,
    ChainWatch,
    DesiredFrame,
    FrameSources,
    skew_fault,
    transform_fault,
)
from kuka_control.model.frame_chain import FrameChain, HandEntries
from kuka_control.numbers import MAX_OFFSET_S, REPEATED_S, STANDS_S, UNCONNECTED_S
from kuka_control.ros.other_clock import NodeClock

REMIND_S = 5.0
STATIC = (
    "The desired tool frame is refused: it came as a static transform, whose stamp never changes; publish it on /tf, "
    "with a new stamp each time."
)
REPEATED = (
    "The desired tool frame is refused: it comes again and again with the same stamp or older ones; give each message "
    "the present time as its stamp."
)
OWN = (
    *(BASE, FLANGE, FLANGE_HOME, FLANGE_MEASURED, FLANGE_DESIRED, FLANGE_SEEN),
    *(TOOL_HOME, TOOL_COMMANDED, TOOL_MEASURED),
)
"""The rig's own frames that are nearly called so."""


class DesiredTool:
    """Listens to tf and wakes the control loop when something came that concerns the desired tool frame. Only frames
    that the base or that frame stand in go to tf2; the newest transforms of the others are kept in case this changes.

    A frame that two nodes publish is left out; a desired tool frame that stands in it counts as refused, as it does
    without a way to the base, when a frame that it stands in jumps, and when ROS time goes back. Bad numbers and stamps
    far from this machine's clock are refused: in tf2 one of the future would hide those after it. Stamps of a publisher
    on another machine, whose clock differs, are corrected before (other_clock.py).

    Attributes:
        stamp: that of the newest desired tool frame, as it came; None before the first.
        offset: of the clock of the node that published it last [s]."""

    def __init__(self, frames: ArmFrames = ONE_ARM) -> None:
        self._base = frames(BASE)
        self._tool = frames(TOOL_DESIRED)
        self._leap = frames(VIRTUAL_LEAP)
        self._known = (*OWN, TOOL_DESIRED) if frames.tf_prefix else OWN
        self.buffer = tf2_ros.Buffer(debug=False)
        self._arrived = clock.Event()
        self._newest: DesiredFrame | None = None
        self._sources = FrameSources()
        self._chain = ChainWatch()
        self._conflict: object = None  # the newest one that was passed on
        self._went_back: str | None = None  # ROS time did, and this was not passed on yet
        self._refused: str | None = None  # why the newest transform of the chain is, and this was not passed on yet
        self._heard = 0.0  # when the frame came last [s]
        self._unconnected = 0.0  # when one came last that could not be used [s]
        self._unconnected_since: float | None = None  # [s]
        self._last_stamp = -math.inf  # of the frame [s]
        self._advanced = 0.0  # when that was later than the one before [s]
        self._missing = f"It waits for the frame {self._tool}."
        self._missed = -math.inf  # when that was found [s]
        self.stamp: rospy.Time | None = None
        self._looked_up: rospy.Time | None = None  # the same, of this machine's clock
        self._clock = NodeClock("")  # of the node that published it last
        self._clocks: dict[str, NodeClock] = {}  # of all that did
        self._foreign = True  # whether it does not stand in the virtual Leap
        self._hands = HandEntries(self._leap, self._tool, frames(HAND_FILTERED))
        self._lock = clock.Lock()  # each publisher on /tf has a thread of its own
        self._last_time = rospy.Time.now()
        self._passed = clock.monotonic()  # when ROS time was seen to pass [s]
        self._frames: FrameChain[RawTransform] = FrameChain(self._tool, self._base)
        rospy.Subscriber("/tf_static", TFMessage, self.static_callback, tcp_nodelay=True)
        rospy.Subscriber("/tf", RawTfMessage, self.callback, tcp_nodelay=True)

    @property
    def offset(self) -> float:
        return self._clock.offset.value

    @property
    def missing(self) -> str | None:
        """Where no desired tool frame comes: that it is awaited, and which frame comes that may have been meant, a
        sentence; else None."""
        now = clock.monotonic()
        if now - self._heard < ABSENT_S:
            return None
        if now - self._missed >= ABSENT_S:
            with self._lock:
                like = self._sources.like(self._tool, now, self._known)
            before, self._missed = self._missing, now
            self._missing = f"It waits for the frame {self._tool}."
            if like is not None:
                self._missing += " What comes is {}, from {}.".format(*like)
                if self._missing != before:
                    rospy.logwarn(self._missing)
        return self._missing

    def callback(self, data: RawTfMessage) -> None:
        node, now = publisher_of(data), clock.monotonic()
        try:
            transforms = list(data.raw_transforms())
        except (struct.error, UnicodeDecodeError) as error:
            rospy.logwarn_throttle(REMIND_S, f"A message of {node} on /tf is damaged and left out: {error}.")
            return
        with self._lock:
            self._check_for_reset()
            arrived = False
            self._hands.take({transform.child for transform in transforms})
            for transform in transforms:
                # Also one that is left out names the frames of a conflict.
                known = self._frames.parents.get(transform.child) == transform.parent
                if transform.child == self._tool:
                    self._heard = now
                if not self._sources.heard(transform.child, transform.parent, node, now):
                    arrived = True
                    continue
                if not known:
                    self._stands_in(transform.child, transform.parent)
                if transform.child == self._tool:
                    self._measure(node, transform, now)
                if node in self._clocks:
                    transform = transform.earlier(self._clocks[node].offset.value)
                if self._frames.needs(transform.child, transform):
                    self._take(transform)
                    arrived = True
        if arrived:
            self._arrived.set()

    def static_callback(self, data: TFMessage) -> None:
        """Receives static transforms, which tf2 keeps all."""
        with self._lock:
            self._check_for_reset()
            for transform in data.transforms:
                child, parent = frame_name(transform.child_frame_id), frame_name(transform.header.frame_id)
                if child == self._tool:
                    self._refused = STATIC
                    continue
                fault = transform_fault(_numbers(transform.transform))
                if fault is not None:
                    rospy.logwarn("The static transform %s -> %s is refused: %s.", parent, child, fault)
                    continue
                self.buffer.set_transform_static(transform, publisher_of(data))
                self._stands_in(child, parent)
        self._arrived.set()

    def _check_for_reset(self) -> None:
        """Forgets all where ROS time went back, as tf2's listener does; where it is simulated, by a recording that
        is played again, the desired tool frame counts as refused."""
        now = rospy.Time.now()
        if now < self._last_time:
            self.buffer.clear()
            self._last_stamp = -math.inf
            if not rospy.rostime.is_wallclock():
                self._went_back = f"ROS time went back by {(self._last_time - now).to_sec():.3g} s."
        if now != self._last_time:
            self._last_time, self._passed = now, clock.monotonic()

    def _stands_in(self, child: str, parent: str) -> None:
        """Notes in which frame another one stands; gives tf2 what it needs from now on."""
        needed = self._frames.put(child, parent)
        self._foreign = self._leap not in self._frames.path(self._tool)
        for transform in needed:
            self._take(transform)

    def _measure(self, node: str, transform: RawTransform, now: float) -> None:
        """Compares the clock of the node that publishes the desired tool frame with this machine's."""
        self._clock = self._clocks.get(node) or self._clocks.setdefault(node, NodeClock(node))
        changed = self._clock.renew(now)
        stamp, present = transform.time - self.offset, rospy.get_time()
        if skew_fault(stamp, present) is not None and stamp > present - MAX_OFFSET_S:
            self._clock.doubt(now)
        if not changed:
            return
        self._last_stamp = -math.inf
        self.buffer.clear()  # of frames that are not corrected, or by another offset
        self._frames.forget()
        offset = self.offset
        if not offset:
            rospy.loginfo("The clock of %s agrees with this machine's again.", node)
            return
        side = "ahead of" if offset > 0.0 else "behind"
        corrected = "The stamps of its frames are corrected by that; synchronise the clocks."
        rospy.logwarn("The clock of %s is %.3f s %s this machine's. %s", node, abs(offset), side, corrected)

    def _take(self, transform: RawTransform) -> None:
        """Passes a transform to tf2; refuses one with bad numbers, and a desired tool frame that is far from now."""
        fault = transform_fault(transform.numbers)
        if fault is not None:
            self._refused = f"The transform {transform.parent} -> {transform.child} is refused: {fault}."
            rospy.logwarn_throttle(REMIND_S, self._refused)
            return
        if transform.child == self._tool:
            present, now = rospy.get_time(), clock.monotonic()
            repeated = transform.time == self._last_stamp
            if transform.time > self._last_stamp:
                self._advanced = now
            self._last_stamp = transform.time
            stands = now - self._passed
            if stands > STANDS_S:
                self._refused = (
                    f"The desired tool frame is refused: ROS time has stood still for {stands:.1f} s; use_sim_time is "
                    "true, and nobody publishes /clock."
                )
                return
            if now - self._advanced > REPEATED_S and transform.time > 0.0:
                self._refused = REPEATED
                return
            skewed = skew_fault(transform.time, present, self._clock.finding)
            older = 0.0 < transform.time <= present - MAX_OFFSET_S  # such a one is refused by its stream
            if skewed is not None and not older:
                self._refused = skewed
                return
            if repeated:
                return  # tf2 would leave it out, with a warning on the terminal for each
        self.buffer.set_transform(transform.message, "tf")

    def wait(self, deadline: float) -> DesiredFrame | None:
        """Returns the newest desired tool frame as soon as a new one is there, or at the monotonic `deadline` [s]."""
        while not self._look() and clock.monotonic() < deadline:
            self._arrived.wait(max(deadline - clock.monotonic(), 0.0))
            self._arrived.clear()
        return self._newest

    def _look(self) -> bool:
        """Looks the frame up; returns whether it is new."""
        now = clock.monotonic()
        went_back, self._went_back = self._went_back, None
        if went_back is not None:
            return self._refuse(went_back)
        refused, self._refused = self._refused, None
        if refused is not None:  # the stamp stays, for the frame before it must not count as new
            self._unconnected, self._unconnected_since = self._heard, None
            return self._refuse_at(now, refused)
        conflict = self._sources.conflict(self._tool, now)
        if conflict is not None:
            if conflict is self._conflict:
                return False
            self._conflict = conflict
            return self._refuse(f"The desired tool frame is refused: {conflict}.")
        try:
            message = self.buffer.lookup_transform(self._base, self._tool, rospy.Time(0))
            stamp = message.header.stamp
            if stamp == self._looked_up:
                return self._unusable(now) and self._refuse_late()
            self._unconnected, self._unconnected_since = self._heard, None
            T_base_tool = pose_from_transform(message.transform)
            self._looked_up, self.stamp = stamp, stamp + rospy.Duration.from_sec(self.offset)
            jump = self._chain_jump(stamp, T_base_tool)
            number, hand = self._clock.offset.number, None if self._foreign else self._hands.count
            self._newest = DesiredFrame(T_base_tool, stamp.to_sec(), jump, None, number, self._foreign, hand)
        except tf2_ros.ExtrapolationException:
            return self._unusable(now) and self._refuse_late()
        except tf2_ros.TransformException:
            return self._unusable(now) and self._refuse_unconnected()
        except ValueError as error:
            rospy.logwarn_throttle(REMIND_S, f"The desired tool frame is refused: {error}.")
            return False
        return True

    def _chain_jump(self, stamp: rospy.Time, T_base_tool: np.ndarray) -> str | None:
        """Returns which frame that the desired tool frame stands in has jumped, a sentence, or None."""
        parent = self._frames.parents.get(self._tool, self._base)
        if parent == self._base:
            return None
        try:
            T_base_parent = pose_from_transform(self.buffer.lookup_transform(self._base, parent, stamp).transform)
        except (tf2_ros.TransformException, ValueError):
            return None
        return self._chain.step(stamp.to_sec(), parent, T_base_parent, T_base_tool)

    def _unusable(self, now: float) -> bool:
        """Whether a desired tool frame came since the last look, and none of those could be used for a while."""
        if self._heard == self._unconnected:
            return False
        self._unconnected = self._heard
        self._unconnected_since = now if self._unconnected_since is None else self._unconnected_since
        return now - self._unconnected_since >= UNCONNECTED_S

    def _refuse_late(self) -> bool:
        """Refuses a desired tool frame that comes with new stamps, in a frame that does not."""
        oldest = math.inf, self._tool
        for frame in self._frames.path(self._tool):
            with contextlib.suppress(tf2_ros.TransformException, KeyError):
                newest = self.buffer.get_latest_common_time(self._frames.parents[frame], frame).to_sec()
                oldest = min(oldest, (newest or math.inf, frame))  # 0: a static one
        newest, frame = oldest
        if newest == math.inf:
            return False
        old = f"it stands in {frame}, whose newest transform is {self._last_stamp - newest:.1f} s older"
        return self._refuse_at(clock.monotonic(), f"The desired tool frame is refused: {old}.")

    def _refuse_unconnected(self) -> bool:
        """Refuses a desired tool frame that comes, but has no way to the base."""
        last = self._frames.path(self._tool)[-1]
        root = self._frames.parents.get(last, last)  # of a circle the frame where it begins
        unknown = f"it stands in {root}, and nobody publishes where that is in {self._base}"
        return self._refuse(f"The desired tool frame is refused: {unknown}.")

    def _refuse(self, conflict: str) -> bool:
        """Refuses what came, and the whole stream with it."""
        self._looked_up = self.stamp = rospy.Time.now()
        return self._refuse_at(self.stamp.to_sec(), conflict=conflict)

    def _refuse_at(self, stamp: float, refused: str | None = None, conflict: str | None = None) -> bool:
        """Refuses what came, by a frame with this stamp [s]. That of a foreign stream does not begin another one, by
        which a bar would end."""
        foreign = self._foreign and self._leap not in self._frames.parents
        self._newest = DesiredFrame(np.eye(4), stamp, conflict, refused, foreign=foreign)
        return True


def _numbers(transform: Transform) -> tuple[float, ...]:
    p, q = transform.translation, transform.rotation
    return p.x, p.y, p.z, q.x, q.y, q.z, q.w
