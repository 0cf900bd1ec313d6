"""Recordings of runs: their files, the reader, and what they are exported to; the programs are in `ros`."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from leap_rig.recording.run import RecordedRun, read

__all__ = ["RecordedRun", "read"]


def __getattr__(name: str) -> Any:
    """Imports the reader where it is used: it needs pinocchio, which not each export's environment has."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from leap_rig.recording import run

    return getattr(run, name)
