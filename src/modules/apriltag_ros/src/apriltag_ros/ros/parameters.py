"""The node's private parameters as typed settings."""

from __future__ import annotations

from apriltag_ros.settings import TAG_KEYS, DetectorSettings, detector_settings, targets
from apriltag_ros.target import Target
from common.ros.params import private_values

OTHERS = ("queue_size", "camera_frame", "tag_border")
"""Keys in the published package's launch files that nothing here depends on."""


def read() -> tuple[DetectorSettings, tuple[Target, ...]]:
    """Returns the settings and what is to be looked for.

    Raises:
        ConfigError: with all faults.
    """
    values = private_values()
    settings = detector_settings(values, prefix="~", others=OTHERS)
    return settings, targets({key: values.get(key) for key in TAG_KEYS})
