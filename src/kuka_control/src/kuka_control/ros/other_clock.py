"""The clock of the node that publishes the desired tool frame. Only one on another machine can have another clock;
it is asked for its time, as the HTTP server of every rospy node tells it in the header of any answer."""

from __future__ import annotations

import http.client
from email.utils import parsedate_to_datetime
from urllib.parse import urlparse
from xmlrpc.client import dumps

import rosgraph.network
import rospy

from common import clock
from common.ros.service_calls import MasterLost, ask_master
from kuka_control.model.clock_offset import ClockOffset, OffsetMeasurement
from kuka_control.numbers import MAX_OFFSET_S

AGAIN_S = 5.0  # shortest time between two measurements because of stamps that are off [s]
RENEW_S = 60.0  # a clock that differs is measured again after this time [s]
FAILURES = 3  # at most, in one measurement, which lasts longer than a second
PAUSE_S = 0.037  # between two; no fraction of a second
ANSWER_S = 0.5  # an answer that takes longer says nothing
SYNCHRONISE = "synchronise the clocks of both machines"


class NoAnswer(Exception):
    """A node does not say its time; the message ends a sentence."""


class NodeClock:
    """The clock of one node, in ROS time of this machine: `offset` corrects its stamps; `finding` is what is known
    about those that are far from now, the end of a sentence."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.offset = ClockOffset()
        self.finding = "its clock is being asked"
        self._result: float | None = None
        self._asked = 0.0
        self._runs = False

    def doubt(self, now: float) -> None:
        """Its stamps are far from `now`, monotonic [s]: asks its clock in a thread, unless that was done just now."""
        if not self._runs and now - self._asked >= (AGAIN_S if self._asked else 0.0):
            self._asked, self._runs = now, True
            clock.Thread(target=self._ask, name=f"clock of {self.node}", daemon=True).start()

    def renew(self, now: float) -> bool:
        """Takes a finished measurement over; returns whether the offset is another one from now on, monotonic [s]."""
        result, self._result = self._result, None
        changed = result is not None and self.offset.measured(result)
        self.offset.pass_to(now)
        if self.offset.value and now - self._asked >= RENEW_S:
            self.doubt(now)
        return changed

    def _ask(self) -> None:
        try:
            self.finding, self._result = self._find()
        except Exception as error:  # a thread that dies would leave the sentence as it is
            self.finding = f"its clock could not be asked: {error!r}; {SYNCHRONISE}"
        finally:
            self._runs = False

    def _find(self) -> tuple[str, float | None]:
        """Returns what is known about its clock, the end of a sentence, and the offset, if that was measured [s]."""
        if not rospy.rostime.is_wallclock():
            return "ROS time is simulated, so no clock differs", None
        try:
            uri = ask_master("lookupNode", self.node)
        except MasterLost:
            return f"the ROS master does not say where {self.node} runs", None
        host = urlparse(uri or "").hostname
        if host is None:
            return f"the ROS master does not know {self.node}", None
        if rosgraph.network.is_local_address(host):
            return f"{self.node} runs on this machine, so its frames are late, or it stamps them wrongly", 0.0
        try:
            offset = measure(uri)
        except NoAnswer as error:
            return f"{self.node} on {host} {error}, so its clock is not known: {SYNCHRONISE}", None
        says = f"{self.node} runs on {host}, whose clock differs by {offset:+.2f} s"
        if abs(offset) > MAX_OFFSET_S:
            return f"{says}, more than {MAX_OFFSET_S:g} s: {SYNCHRONISE}", offset
        return f"{says}; beyond that its frames are late, or it stamps them wrongly", offset


def measure(uri: str) -> float:
    """Returns by how much the clock of the node at an address is ahead of this machine's [s]; NoAnswer: not known."""
    exchanges = 60  # at most, in one measurement, which lasts longer than a second
    measurement, failures = OffsetMeasurement(), 0
    address = urlparse(uri)
    body = dumps((rospy.get_caller_id(),), "getPid")
    for _ in range(exchanges):
        connection = http.client.HTTPConnection(address.hostname, address.port, timeout=ANSWER_S)
        try:
            connection.connect()
            sent = clock.time()
            connection.request("POST", "/", body, {"Content-Type": "text/xml"})
            date = connection.getresponse().getheader("Date")
            received = clock.time()
            stated = parsedate_to_datetime(date or "").timestamp()
        except (TypeError, ValueError):
            raise NoAnswer("says no time, which only nodes in Python do") from None
        except (OSError, http.client.HTTPException):
            failures += 1
            if failures == FAILURES:
                raise NoAnswer("does not answer") from None
            continue
        finally:
            connection.close()
        measurement.answered(sent, received, stated)
        if measurement.offset is not None:
            return measurement.offset
        clock.sleep(PAUSE_S)
    raise NoAnswer("answers too slowly")
