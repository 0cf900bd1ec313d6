"""The published networks stand beside the tests; torch keeps to one processor, which small images do best with."""

from __future__ import annotations

import sys
from pathlib import Path

import torch

sys.path.append(str(Path(__file__).parent))
torch.set_num_threads(1)
