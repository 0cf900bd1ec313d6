"""The graph in virtual time: the laws that hold for rospy, too, and what nodes meet that live on it."""

from __future__ import annotations

import runpy

import pytest

from tests import graph_laws

pytestmark = pytest.mark.ros


@pytest.fixture
def ros(virtual_graph):
    return virtual_graph


@pytest.fixture
def wait(ros):
    return ros.wait_until


@pytest.fixture
def log(ros):
    return lambda: ros.here.log


@pytest.fixture
def start(ros):
    def run(file, *words):
        return ros.start(file.name, lambda: runpy.run_path(str(file), run_name="__main__"), str(file), *words)

    return run


class TestTopics(graph_laws.Topics):
    pass


class TestServices(graph_laws.Services):
    pass


class TestParameters(graph_laws.Parameters):
    pass


class TestLives(graph_laws.Lives):
    pass
