#!/usr/bin/env bash
# All tests. First those of the whole rig that check how arm and hand follow, one by one, and on what these leave of the
# processors the tests of single nodes, which mostly wait, three side by side. Then the other tests of the whole rig, two
# at a time, as a rig takes most of a core. Those without ROS run behind all of these, beside two rigs only where a
# processor is idle. What ran in the background is printed when it has ended.
# Options of pytest may follow.
set -uo pipefail
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again
# To import the other files takes each process of pytest ten seconds.
with_mark() { grep -rlE "mark\.($1)\b" --include='test_*.py' src tests | sort; }
mapfile -t with_ros < <(with_mark 'ros|rig')
mapfile -t with_rig < <(with_mark rig)
mapfile -t with_alone < <(with_mark alone)

code=0
logs=$(mktemp -d)
started=()
start() {  # start NAME NICENESS MARKERS [PYTEST'S OPTIONS AND FILES]...: in the background
  (trap - INT; exec setsid nice -n "$2" python -m pytest -m "${@:3}" > "$logs/$1" 2>&1) &
  started+=("$!")
}
finish() {  # finish NAME PID: waits for it and prints what it said
  wait "$2" || code=$?
  cat "$logs/$1"
}
# Pytest ends the rigs that it has started when it is interrupted.
trap '{ kill -INT "${started[@]}"; wait; printf -- "-%s\n" "${started[@]}" | xargs -n 1 kill --; } 2> /dev/null; rm -rf "$logs"' EXIT
trap 'exit 130' INT TERM HUP  # pytest takes Ctrl-C and exits, after which this script would run the next tests

start pure 10 "not ros and not rig" -n 2 --dist worksteal "$@"
pure=${started[-1]}
start alone 0 alone "$@" "${with_alone[@]}"
nice -n 5 python -m pytest -m "ros and not rig" -n 3 --dist worksteal "$@" "${with_ros[@]}" || code=$?
finish alone "${started[-1]}"
# Any other program that becomes ready takes the processor from one of this class at once.
pgrep -s "$pure" | xargs -rn 1 chrt --all-tasks --idle --pid 0 2> /dev/null
python -m pytest -m "rig and not alone" -n 2 --dist loadgroup "$@" "${with_rig[@]}" || code=$?
finish pure "$pure"
exit "$code"
