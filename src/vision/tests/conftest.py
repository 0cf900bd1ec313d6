"""Makes the helpers of these tests, and the renderer of tags, importable."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path += [str(HERE), str(HERE.parents[1] / "modules" / "apriltag_ros" / "tests")]
