"""What was made from which sources: a file of checksums, so that nothing that was exported grows stale unseen."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

FOLDER = Path(__file__).parent
FILE = FOLDER / "manifest.json"
SHARED = ("dimensions.py", "shapes.py", "drawing.py", "build.py")


def checksum(*files: Path) -> str:
    """Returns the SHA-256 of files one after the other."""
    digest = hashlib.sha256()
    for file in files:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def sources(part: str) -> list[Path]:
    """Returns all that a part is made from."""
    return [*(FOLDER / name for name in SHARED), FOLDER / part / "part.py"]


def exported(part: str) -> list[Path]:
    """Returns the files that are made from a part: STEP, STL, drawing."""
    return [FOLDER / part / f"{part}.{kind}" for kind in ("step", "stl", "svg")]


def stl(part: str) -> Path:
    """Returns the part's STL file."""
    return FOLDER / part / f"{part}.stl"


def read() -> dict[str, dict[str, str]]:
    """Returns the checksum of the sources and that of the file, by the file's name in the folder cad."""
    return json.loads(FILE.read_text()) if FILE.exists() else {}


def record(files: list[Path], made_from: list[Path]) -> None:
    """Notes what files were made from."""
    entries = read()
    for file in files:
        name = file.relative_to(FOLDER).as_posix()
        entries[name] = {"sources": checksum(*made_from), "file": checksum(file)}
    FILE.write_text(json.dumps(dict(sorted(entries.items())), indent=1) + "\n")
