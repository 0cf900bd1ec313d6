#!/usr/bin/env python3
"""Program that judges recorded episodes before a training."""

from leap_rig.recording.ros.dataset_report_program import main

main()
