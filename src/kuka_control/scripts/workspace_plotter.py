#!/usr/bin/env python3
"""Shows the workspace, and says what is wrong with a bad one. See --help."""

from common.ros.node import need_home

need_home("workspace_plotter")

from kuka_control.ros.plotter_program import main  # noqa: E402

main()
