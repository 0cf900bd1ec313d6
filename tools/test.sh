#!/usr/bin/env bash
# All tests. Those without ROS run behind the others, on what these leave of the processor: the tests of single nodes,
# which mostly wait, many side by side, and those of the whole rig, two at a time, as a rig takes about one core. Beside
# a rig they only run where a processor is idle; tests that want the processors for themselves come last.
# Options of pytest may follow.
set -uo pipefail
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again
# To import the other files takes each process of pytest ten seconds.
with_mark() { grep -rlE "mark\.($1)\b" --include='test_*.py' src tests | sort; }
mapfile -t with_ros < <(with_mark 'ros|rig')
mapfile -t with_rig < <(with_mark rig)
mapfile -t with_alone < <(with_mark alone)

code=0
run() {  # run MARKERS [PYTEST'S OPTIONS AND FILES]...
  python -m pytest -m "$@" || code=$?
}
log=$(mktemp)
setsid nice -n 10 python -m pytest -m "not ros and not rig" -n 2 --dist worksteal "$@" > "$log" 2>&1 &
pure=$!
trap 'kill -- "-$pure" 2> /dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT  # pytest takes Ctrl-C and exits, after which this script would run the next tests
run "ros and not rig" -n 4 --dist worksteal "$@" "${with_ros[@]}"
# Any other program that becomes ready takes the processor from one of this class at once.
pgrep -s "$pure" | xargs -rn 1 chrt --all-tasks --idle --pid 0 2> /dev/null
run "rig and not alone" -n 2 --dist loadgroup "$@" "${with_rig[@]}"
chrt --pid "$pure" 2> /dev/null | grep -q IDLE || wait "$pure"  # it has ended, or this machine cannot do so
run alone "$@" "${with_alone[@]}"
wait "$pure" || code=$?
cat "$log"
exit "$code"
