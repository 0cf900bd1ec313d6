#!/usr/bin/env python3
"""Takes this package's pictures for the handbook; see --help."""

import sys

from vision.ros.pictures_program import main

sys.exit(main())
