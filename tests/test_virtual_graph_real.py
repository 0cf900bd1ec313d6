"""The laws of the graph in virtual time, on rospy itself: the stand-in does what it does."""

from __future__ import annotations

import logging
import sys

import pytest

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


class TestTopics(graph_laws.Topics):
    pass


class TestServices(graph_laws.Services):
    pass


class TestParameters(graph_laws.Parameters):
    pass


@pytest.fixture
def start(processes):
    return lambda file, *words: processes.start(sys.executable, str(file), *words)


class TestLives(graph_laws.Lives):
    pass
