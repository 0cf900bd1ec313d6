#!/bin/sh
# behind.sh N PROGRAM [ARGUMENT]...: a program that leaves the processor to the control loops where it is scarce.
# Linux shares the processor among sessions first (sched(7), autogroup), and roslaunch starts each node in a session of
# its own: there `nice` alone has no effect.
niceness=$1
shift
if [ "$(cut -d ' ' -f 6 /proc/$$/stat)" = $$ ]; then
  echo "$niceness" 2>/dev/null > /proc/$$/autogroup || true
fi
exec nice -n "$niceness" "$@"
