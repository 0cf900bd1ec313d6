"""The laws of the graph in virtual time, on rospy itself: the stand-in does what it does."""

from __future__ import annotations

import logging
import sys

import pytest

pytest.importorskip("rospy")
from tests import graph_laws

pytestmark = pytest.mark.ros


@pytest.fixture(name="wait")
def waits(wait_until):
    return wait_until


@pytest.fixture
def log():
    lines = []
    handler = logging.Handler()
    handler.emit = lambda record: lines.append(record.getMessage())
    logging.getLogger("rosout").addHandler(handler)
    yield lambda: "\n".join(lines)
    logging.getLogger("rosout").removeHandler(handler)


@pytest.fixture
def start(processes):
    return lambda file, *words: processes.start(sys.executable, str(file), *words)


@pytest.mark.real
class TestMostTelling:
    pair = graph_laws.Topics.pair
    test_messages_come_in_order = graph_laws.Topics.test_messages_come_in_order_with_who_sent_them
    test_what_goes_wrong_is_told_to_the_caller = graph_laws.Services.test_what_goes_wrong_is_told_to_the_caller
    test_a_life = graph_laws.Lives.test_a_life


@pytest.mark.long
class TestTopics(graph_laws.Topics):
    pass


@pytest.mark.long
class TestServices(graph_laws.Services):
    pass


@pytest.mark.long
class TestParameters(graph_laws.Parameters):
    pass


@pytest.mark.long
class TestLives(graph_laws.Lives):
    pass
