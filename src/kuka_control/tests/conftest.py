"""The world of the control loops beside the tests, and the simulated arm of the benchmarks."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path += [str(Path(__file__).parent), str(Path(__file__).parents[3])]  # where bench is a package
