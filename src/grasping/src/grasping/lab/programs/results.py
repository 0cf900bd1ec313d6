"""Results of the evaluation programs: a table in Markdown, and a CSV file to which an interrupted run appends."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Returns a table in Markdown."""
    lines = (header, ["---"] * len(header), *rows)
    return "".join(f"| {' | '.join(cells)} |\n" for cells in lines)


class ResultsFile:
    """A CSV file of results; rows of an earlier run are read first.

    Raises:
        OSError: the file cannot be read or written.
    """

    def __init__(self, path: Path, columns: Sequence[str]) -> None:
        path.parent.mkdir(parents=True, exist_ok=True)
        self.rows: list[dict] = []
        if path.exists():
            with path.open(newline="") as file:
                self.rows = list(csv.DictReader(file))
        self._file = path.open("a", newline="")
        self._writer = csv.DictWriter(self._file, columns, lineterminator="\n")
        if not self.rows:
            self._writer.writeheader()

    def add(self, rows: list[dict]) -> None:
        """Appends rows to the file."""
        self._writer.writerows(rows)
        self._file.flush()
        self.rows += rows

    def close(self) -> None:
        self._file.close()
