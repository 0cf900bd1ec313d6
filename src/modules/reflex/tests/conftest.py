"""A hand and its driver in one process, in a time that the test lets pass."""

from __future__ import annotations

from pathlib import Path

import pytest

from reflex.calibration import FingerZeros, TactileOffsets, parse_calibration
from reflex.hand import HandLogic
from reflex.settings import HandSettings
from rig_simulation.devices.reflex.hand import PERIOD_S, SimulatedHand
from rig_simulation.devices.reflex.wire import read_command

CONFIG = Path(__file__).parents[1] / "config"
SOURCE = ("10.99.99.99", 11333)


def settings_with(**changes) -> HandSettings:
    """The shipped settings, some of them changed."""
    return HandSettings(**changes)


def shipped_calibration():
    """The calibration that comes with the package."""
    records = (FingerZeros, TactileOffsets)
    return tuple(parse_calibration(record, (CONFIG / record.FILE).read_text(), record.FILE) for record in records)


class Bench:
    """Driver and simulated hand joined packet by packet."""

    def __init__(self, seed: int = 0, calibrated: bool = False, **changes) -> None:
        self.settings = settings_with(**changes)
        self.device = SimulatedHand(seed)
        self.driver = HandLogic(self.settings, *shipped_calibration(), calibrated)
        self.now = 100.0
        self.sent: list[bytes] = []
        self.notes: list = []
        self.zeros = self.offsets = self.reading = None
        self.take(self.driver.start())

    def take(self, result):
        """Carries the driver's packets to the hand and keeps what it said."""
        for data in result.send:
            self.sent.append(data)
            if not self.device.silent:
                self.device.handle(read_command(data))
        self.notes += result.notes
        self.zeros = result.zeros or self.zeros
        self.offsets = result.offsets or self.offsets
        self.reading = result.reading or self.reading
        return result

    def run(self, seconds: float, until=None) -> bool:
        """Lets time pass, at most until the condition holds; returns whether it held."""
        for _ in range(round(seconds / PERIOD_S)):
            if until and until():
                return True
            self.device.step(PERIOD_S)
            for _ in range(5):
                self.now += PERIOD_S / 5
                self.take(self.driver.tick(self.now))
            if not self.device.silent:
                self.take(self.driver.receive(self.device.packet(), SOURCE, self.now))
        return bool(until and until())

    def calibrated(self):
        """Lets the driver calibrate the fingers; returns this bench."""
        self.run(0.3)
        self.take(self.driver.calibrate_fingers(self.now))
        assert self.run(5.0, lambda: self.driver.calibration_outcome == "succeeded"), self.notes
        return self

    def command(self, *angles):
        """Sends a command in radians."""
        return self.take(self.driver.command(angles, self.now))

    def said(self, text: str) -> bool:
        """Whether the driver said something with this text in it."""
        return any(text in note.text for note in self.notes)


@pytest.fixture
def bench():
    """Makes benches: bench(seed, setting=value)."""
    return Bench


@pytest.fixture
def make_settings():
    """The function settings_with."""
    return settings_with


@pytest.fixture
def config_folder():
    """Folder of the files that come with the package."""
    return CONFIG


@pytest.fixture
def shipped():
    """Zeros and offsets that come with the package."""
    return shipped_calibration()
