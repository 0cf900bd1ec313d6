"""Making many files with several processes."""

from __future__ import annotations

import argparse
import multiprocessing
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from tqdm import tqdm

Task = TypeVar("Task")


def make_all(
    parser: argparse.ArgumentParser,
    folder: Path,
    make: Callable[[Task], object],
    tasks: Sequence[Task],
    processes: int,
    unit: str,
) -> None:
    """Makes the folder, then each file in it, and shows how far it is.

    A folder or file that cannot be written ends the program with a sentence; what was made stays and is not made again.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        # A fork would inherit the locks of the libraries' threads.
        with multiprocessing.get_context("spawn").Pool(processes) as pool:
            for _ in tqdm(pool.imap_unordered(make, tasks), total=len(tasks), unit=unit):
                pass
    except OSError as error:
        parser.error(f"{error.filename or folder} cannot be written: {error.strerror}.")
