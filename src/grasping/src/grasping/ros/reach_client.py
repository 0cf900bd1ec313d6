"""Asks the arm's controller in its own thread whether it reaches grasps; the images never wait for it."""

from __future__ import annotations

import rospy

from common import clock
from common.frames import BASE
from common.mounting import mounting_frame
from common.ros.conversions import stamped_pose
from common.ros.service_calls import ServiceFailed, call
from grasping.pipeline.pipeline import GraspProposal
from grasping.pipeline.tool_pose import (
    ASKED,
    SILENT,
    Reachability,
    ReachabilityCache,
    ReachConfig,
    ToolPoseConfig,
    above,
    taken,
    tool_pose,
)
from rig_msgs.srv import CheckToolPose

SERVICE = "kuka/check_tool_pose"
UPRIGHT = (0.0, 0.0, 0.0)  # used until the arm's parameters are set


class ReachClient:
    """Looks up whether the arm reaches a grasp."""

    def __init__(self, config: ReachConfig, tool: ToolPoseConfig) -> None:
        self._config = config
        self._tool = tool
        self._book = ReachabilityCache(config)
        self._lock = clock.Lock()
        self._questions: clock.Queue[GraspProposal] = clock.Queue(maxsize=config.best)
        self._failed = False
        self._busy_since = 0.0
        self.answers = 0
        if config.ask:
            clock.Thread(target=self._loop, name="reach", daemon=True).start()

    def look_up(self, proposals: tuple[GraspProposal, ...]) -> list[tuple[GraspProposal, Reachability]]:
        """Returns the grasps with their reachability, refused ones last; asks about the best, others are unknown."""
        now = clock.monotonic()
        with self._lock:
            self._book.keep_only({p.id for p in proposals})
            known = [(p, self._known(p, i, now)) for i, p in enumerate(proposals)]
        return sorted(known, key=lambda pair: pair[1].refused)

    def _known(self, proposal: GraspProposal, rank: int, now: float) -> Reachability:
        if proposal.T_base_grasp is None:
            return Reachability(False, "the camera pose in kuka/base_frame is unknown")
        if not self._config.ask:
            return Reachability(True, "")
        if rank >= self._config.best:
            return Reachability(False, f"only the {self._config.best} best grasps are checked")
        if self._book.wanted(proposal.id, proposal.T_base_grasp, now):
            try:
                self._questions.put_nowait(proposal)
                self._book.asked(proposal.id, proposal.T_base_grasp, now)
            except clock.Full:
                pass  # the next image asks again
        silent = self._failed or (self._busy_since and now - self._busy_since > self._config.timeout)
        return self._book.known(proposal.id) or Reachability(False, SILENT if silent else ASKED)

    def _loop(self) -> None:
        poll_s = 0.2
        while not rospy.is_shutdown():
            try:
                proposal = self._questions.get(timeout=poll_s)
            except clock.Empty:
                continue
            self._busy_since = clock.monotonic()
            answer = self._answer(proposal)
            self._busy_since, self._failed = 0.0, answer is None
            with self._lock:
                self._book.answered(proposal.id, answer)

    def _answer(self, proposal: GraspProposal) -> Reachability | None:
        """Returns what the controller says of the grasp and of where the tool waits before it, None if it does not
        answer."""
        ahead = (1.0, 0.0, 0.0)  # used until the arm's parameters are set
        try:
            line, mounting = rospy.get_param("kuka/center_line", ahead), rospy.get_param("kuka/mounting", UPRIGHT)
            home = mounting_frame(line, mounting)
            tool = taken(self._tool, proposal.own_approach)
            T = tool_pose(proposal.T_base_grasp, tool, home.R_base_tool, home.up)
        except (TypeError, ValueError) as error:
            return Reachability(False, str(error), True)
        try:
            timeout = self._config.timeout
            for T_asked in (T, above(T, tool.clearance)):
                asked = stamped_pose(T_asked, BASE, rospy.Time.now())
                found = call(SERVICE, CheckToolPose, asked, timeout=timeout, wait=timeout)
                if not found.success:
                    break
        except ServiceFailed:
            return None
        self.answers += 1
        return Reachability(found.success, "" if found.success else found.message.rstrip("."), not found.success)
