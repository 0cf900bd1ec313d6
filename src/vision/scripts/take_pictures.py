#!/usr/bin/env python3
"""Takes this package's pictures for the handbook; see --help."""

import sys

from vision.ros.screenshots_program import main

sys.exit(main())
