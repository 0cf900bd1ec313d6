"""Errors that a person reads: every message is one plain sentence that names the value and what is wrong with it."""

from __future__ import annotations


class RigError(Exception):
    """Base of the errors that end a program with one sentence instead of a traceback."""


class ConfigError(RigError):
    """A configuration holds values that the rig must not run with.

    Attributes:
        faults: one sentence per fault, all that were found.
    """

    def __init__(self, faults: list[str] | tuple[str, ...]) -> None:
        self.faults = tuple(faults)
        super().__init__(" ".join(self.faults))


class DeviceError(RigError):
    """A device did not answer, answered wrongly, or refused."""
