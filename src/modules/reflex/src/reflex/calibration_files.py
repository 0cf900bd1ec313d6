"""The files in which a hand's calibration is kept, in a folder that the user may write."""

from __future__ import annotations

import contextlib
import os
import tempfile
from pathlib import Path

from reflex.calibration import DEFAULTS, Calibration, FingerZeros, TactileOffsets, calibration_text, parse_calibration
from reflex.errors import CalibrationFileError


class CalibrationFiles:
    """Reads and writes the two files in `folder`, which may begin with ~ and is made when something is saved; where
    none was saved, reads those in `shipped`, or takes this package's values if that is None. The files of a
    `simulated` hand say so, and serve no real one."""

    def __init__(self, folder: str, shipped: Path | None = None, simulated: bool = False) -> None:
        self.folder = Path(os.path.expanduser(folder))
        self._shipped = shipped
        self._simulated = simulated

    def load(self) -> tuple[FingerZeros, TactileOffsets, bool]:
        """Returns both calibrations, and whether that of the fingers was saved for this hand; raises
        CalibrationFileError if a file cannot be read or holds something else."""
        zeros, calibrated = self._read(FingerZeros)
        offsets, _ = self._read(TactileOffsets)
        return zeros, offsets, calibrated

    def save(self, calibration: FingerZeros | TactileOffsets) -> Path:
        """Writes one calibration and returns its file; raises CalibrationFileError if the disk is full or the folder
        cannot be written: the old file stays whole."""
        path = self.folder / calibration.FILE
        try:
            _write_whole(path, calibration_text(calibration, self._simulated))
        except OSError as error:
            raise CalibrationFileError(
                f"Cannot write {path}: {error.strerror}; the calibration holds until the driver exits."
            ) from None
        return path

    def _read(self, record: type[Calibration]) -> tuple[Calibration, bool]:
        path = self.folder / record.FILE
        try:
            saved = path.exists()
            if not saved:
                if self._shipped is None:
                    return DEFAULTS[record], False
                path = self._shipped / record.FILE
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise CalibrationFileError(f"Cannot read {path}: {error}.") from None
        return parse_calibration(record, text, str(path), self._simulated), saved


def _write_whole(path: Path, text: str) -> None:
    """Writes a file in place of the old one, which stays whole if that fails; makes its folder."""
    path.parent.mkdir(parents=True, exist_ok=True)
    handle, temporary = tempfile.mkstemp(prefix=f".{path.name}", dir=str(path.parent))
    try:
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        os.chmod(temporary, 0o644)
        os.replace(temporary, path)
    except OSError:
        with contextlib.suppress(OSError):
            os.unlink(temporary)
        raise
