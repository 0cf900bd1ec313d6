"""A client of actions learns of the end of a goal, however early it comes."""

from __future__ import annotations

import pytest

from common import clock

pytest.importorskip("rig_msgs.srv")
import rospy
from actionlib_msgs.msg import GoalStatus

from common.ros.action_client import ActionClient
from kuka_msgs.msg import MoveAction, MoveActionResult, MoveGoal, MoveResult

pytestmark = pytest.mark.ros


def test_a_result_that_comes_before_the_goal_is_sent_counts(ros):
    client = ActionClient("move", MoveAction)
    manager = client.action_client.manager

    def refuse_at_once(goal):
        status = GoalStatus(goal_id=goal.goal_id, status=GoalStatus.REJECTED)
        result = MoveActionResult(status=status, result=MoveResult(message="refused"))
        clock.Thread(target=manager.update_results, args=(result,)).start()
        clock.sleep(0.2)  # longer than a result takes that does not wait

    manager.register_send_goal_fn(refuse_at_once)
    client.send_goal(MoveGoal())
    begun = clock.monotonic()
    assert client.wait_for_result(rospy.Duration(20.0)) and clock.monotonic() == begun
    assert client.get_result().message == "refused"
