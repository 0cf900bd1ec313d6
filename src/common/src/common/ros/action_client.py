"""A client of actions that misses nothing of a goal."""

from __future__ import annotations

import actionlib


class ActionClient(actionlib.SimpleActionClient):
    """actionlib's simple client, which also notes what happens to a goal before `send_goal` has returned. actionlib's
    own drops that: on a busy machine it never learned that a goal was refused."""

    def send_goal(self, *args, **options) -> None:
        """Sends a goal; see actionlib.SimpleActionClient."""
        with self.action_client.manager.list_mutex:  # what comes from the server waits for it
            super().send_goal(*args, **options)
