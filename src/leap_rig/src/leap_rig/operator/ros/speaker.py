"""Plays sounds by `aplay`, of Debian's package alsa-utils; without it, or without a sound card, all stays silent."""

from __future__ import annotations

import subprocess

import rospy

from common import clock
from leap_rig.operator.cues import Beep, Sound, wav

LONGEST_S = 3.0


class Speaker:
    """Plays one sound at a time in a thread of its own; the first that fails is the last."""

    def __init__(self, program: str = "aplay") -> None:
        self._command = [program, "-q", "-"]
        self._busy = clock.Lock()
        self.silent = False  # after a failure

    def play(self, sound: Sound | Beep) -> None:
        """Starts the sound; leaves it out while the one before still plays, or after a failure."""
        if not self.silent and self._busy.acquire(blocking=False):
            clock.Thread(target=self._run, args=(wav(sound),), name="sound", daemon=True).start()

    def _run(self, file: bytes) -> None:
        try:
            subprocess.run(self._command, input=file, timeout=LONGEST_S, check=True, capture_output=True)
        except (OSError, subprocess.SubprocessError) as error:
            self.silent = True
            said = (getattr(error, "stderr", None) or b"").decode(errors="replace").strip().partition("\n")[0]
            rospy.logwarn("No sounds: %s. The rig works without them.", said or error)
        finally:
            self._busy.release()
