#!/bin/sh
# simulated.sh rig|camera PROGRAM [ARGUMENT]...: says that what is launched is simulated, and how to get the real one,
# before the first program of a launch file starts, so that this line comes first.
case "$1" in
  rig)
    echo "Everything is simulated: no real arm or hand moves. For the real rig: sim:=false," \
         "and robot_ip:= and hand_interface:= where they are not 172.31.1.147 and eth0."
    ;;
  camera) echo "The camera is simulated. For the Xtion Pro Live: leave sim:=true out." ;;
esac
shift
exec "$@"
