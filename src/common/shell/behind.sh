#!/bin/sh
# behind.sh N|idle PROGRAM [ARGUMENT]...: a program that leaves the processor to the control loops where it is scarce:
# with niceness N it gets a smaller fraction; with `idle` only what the others leave, and each of them displaces it at
# once (SCHED_IDLE, sched(7)).
# Linux shares the processor among sessions first (sched(7), autogroup), and roslaunch starts each node in a session of
# its own: there `nice` alone has no effect.
# LEAP_RIG_NICENESS replaces N: where single nodes are tested side by side, none may starve.
behind=${LEAP_RIG_NICENESS:-$1}
shift
if [ "$behind" = idle ]; then
  niceness=19
else
  niceness=$behind
fi
if [ "$(cut -d ' ' -f 6 /proc/$$/stat)" = $$ ]; then
  echo "$niceness" 2>/dev/null > /proc/$$/autogroup || true
fi
if [ "$behind" = idle ]; then
  exec chrt --idle 0 "$@"
fi
exec nice -n "$niceness" "$@"
