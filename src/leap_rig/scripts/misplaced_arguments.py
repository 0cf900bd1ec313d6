#!/usr/bin/env python3
"""Says which arguments of demo.launch do not go with the number of arms; the launch ends with it."""

import sys

from leap_rig.misplaced_arguments import sentence

robots, *arguments = [word for word in sys.argv[1:] if not word.startswith("__")]
sys.exit(sentence(int(robots), arguments))
