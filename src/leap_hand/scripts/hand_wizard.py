#!/usr/bin/env python3
"""Measures a person's open and closed hand and stores the finger mapping under a name; see --help."""

from leap_hand.ros.wizard_program import main

main()
