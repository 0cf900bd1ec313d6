#!/usr/bin/env bash
# Starts the control of the real rig: all nodes, the control panel, then the arm's real-time controller; with --sim of
# the simulated one, devices included. Other arguments go to leap_rig.launch:
# run_leap_control.sh robot_ip:=172.31.1.147 hand_interface:=eth0
set -eo pipefail
sim=false
leap_port=6437
for argument in "$@"; do
  shift
  case "$argument" in
    --sim | sim:=[tT]rue | sim:=TRUE | sim:=1) sim=true ;;
    sim:=[fF]alse | sim:=FALSE | sim:=0) sim=false ;;
    *) set -- "$@" "$argument" ;;
  esac
  case "$argument" in leap_port:=*) leap_port=${argument#*:=} ;; esac
done
if [ "$sim" = true ] && (exec 3<>"/dev/tcp/127.0.0.1/$leap_port") 2>/dev/null; then
  echo "Port $leap_port is busy, so the simulated Leap service cannot listen there; nothing was started." >&2
  echo "End the Leap service that runs (run_leapd.sh, or another rig), or choose a port: leap_port:=6438." >&2
  exit 1
fi
source "$(dirname "$(readlink -f "$0")")/workspace.sh"
set -u  # not before: the set-up files of ROS read variables that a plain terminal lacks
# In one launch, so that the controller takes its parameters and not what an earlier launch left on a living master.
exec roslaunch leap_rig leap_rig.launch controller:=true "sim:=$sim" "$@"
