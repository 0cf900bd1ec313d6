"""Errors for the user: each message names the value, what is wrong with it, and what to do."""

from __future__ import annotations


class RigError(Exception):
    """Base of the errors that a program reports with one sentence instead of a traceback."""


class ConfigError(RigError):
    """A configuration has invalid values; `faults` has all of them, one sentence each."""

    def __init__(self, faults: list[str] | tuple[str, ...]) -> None:
        self.faults = tuple(faults)
        super().__init__(" ".join(self.faults))


class DeviceError(RigError):
    """A device did not answer, answered wrongly, or refused."""
