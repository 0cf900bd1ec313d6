"""A simulated device that starts is waited for without a word; one that stays silent is complained of."""

from __future__ import annotations

import pytest

pytest.importorskip("rospy")
from common.errors import DeviceError
from rig_simulation.ros import silence as module
from rig_simulation.ros.silence import START_S, Silence


@pytest.fixture
def rig(monkeypatch):
    class Rig:
        now = 100.0
        warnings: list[str]

    Rig.warnings = []
    monkeypatch.setattr(module.time, "monotonic", lambda: Rig.now)
    monkeypatch.setattr(module.rospy, "logwarn_throttle", lambda _, text, error: Rig.warnings.append(text % error))
    return Rig


@pytest.mark.parametrize(
    ("answers_at", "asked_at", "warned"),
    [
        (None, 0.9 * START_S, False),
        (None, 1.1 * START_S, True),
        (START_S, 1.9 * START_S, False),
        (START_S, 2.1 * START_S, True),
    ],
)
def test_only_what_lasts_is_said(rig, answers_at, asked_at, warned):
    silence = Silence()
    if answers_at is not None:
        rig.now = 100.0 + answers_at
        silence.is_over()
    rig.now = 100.0 + asked_at
    silence.goes_on(DeviceError("It does not answer."))
    assert rig.warnings == (["It does not answer."] if warned else [])
