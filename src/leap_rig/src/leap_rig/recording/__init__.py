"""Recordings of runs: their files, the reader, and what they are exported to; the programs are in `ros`."""

from leap_rig.recording.run import RecordedRun, read

__all__ = ["RecordedRun", "read"]
