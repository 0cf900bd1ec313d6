#!/usr/bin/env python3
"""Takes this package's images for the handbook; see --help."""

import sys

from vision.ros.screenshots_program import main

sys.exit(main())
