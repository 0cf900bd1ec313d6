#!/usr/bin/env python3
"""Takes this package's images for the handbook; see --help."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tools.vision_pictures import main

sys.exit(main())
