#!/usr/bin/env bash
# All tests, in four parts, one after another: those of single nodes, which mostly wait, many side by side; those of the
# whole rig, which waits for faults and takes half a processor; demos at the rates of the real rig, which take most of
# one; and those that want the processors for themselves. Those without ROS run behind all of them: beside a rig only
# where a processor is idle.
# Options of pytest may follow.
set -uo pipefail
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again
# To import the other files takes each process of pytest ten seconds.
with_mark() { grep -rlE "mark\.($1)\b" --include='test_*.py' src tests | sort; }
mapfile -t with_ros < <(with_mark 'ros|rig')
mapfile -t with_rig < <(with_mark rig)
mapfile -t with_full_rate < <(with_mark full_rate)
mapfile -t with_alone < <(with_mark alone)

code=0
run() {  # run MARKERS [PYTEST'S OPTIONS AND FILES]...
  python -m pytest -m "$@" || code=$?
}
log=$(mktemp)
# As long as a part goes on, a test behind it may get no processor at all.
setsid nice -n 10 python -m pytest -m "not ros and not rig" -n 2 --dist worksteal -o timeout=1200 "$@" > "$log" 2>&1 &
pure=$!
trap 'kill -- "-$pure" 2> /dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT  # pytest takes Ctrl-C and exits, after which this script would run the next tests
run "ros and not rig" -n 4 --dist worksteal "$@" "${with_ros[@]}"
# Any other program that becomes ready takes the processor from one of this class at once, and Linux shares the
# processor among sessions first (sched(7), autogroup).
pgrep -s "$pure" | xargs -rn 1 chrt --all-tasks --idle --pid 0 2> /dev/null
echo 19 2> /dev/null > "/proc/$pure/autogroup"
run "rig and not full_rate and not alone" -n 3 --dist loadgroup "$@" "${with_rig[@]}"
chrt --pid "$pure" 2> /dev/null | grep -q IDLE || wait "$pure"  # it has ended, or this machine cannot do so
run "full_rate and not alone" -n 2 "$@" "${with_full_rate[@]}"
run alone "$@" "${with_alone[@]}"
wait "$pure" || code=$?
cat "$log"
exit "$code"
