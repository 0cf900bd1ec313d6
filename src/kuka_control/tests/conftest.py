"""The simulated arm of the benchmarks serves tests too."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[3]))  # where bench is a package
