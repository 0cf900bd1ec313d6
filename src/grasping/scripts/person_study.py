#!/usr/bin/env python3
"""Leads through the study of people who grasp with the network."""

from grasping.lab.programs.person_study import main

if __name__ == "__main__":
    main()
