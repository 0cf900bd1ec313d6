#!/usr/bin/env bash
# Starts the control of the rig: all nodes, then the arm's real-time controller. Arguments go to leap_rig.launch,
# for the real rig: run_leap_control.sh sim:=false robot_ip:=172.31.1.147
set -eo pipefail
source "$(dirname "$(readlink -f "$0")")/../../../devel/setup.bash"
set -u  # not before: the set-up files of ROS read variables that a plain terminal lacks
roslaunch leap_rig leap_rig.launch "$@" &
rig=$!
trap 'kill -INT "$rig" 2>/dev/null || true; wait "$rig" || true' EXIT
rosrun kuka_control real_time_controller.py
