#!/usr/bin/env bash
# All tests, in four parts, one after another: demos at the rates of the real rig, which take most of a processor; those
# of the whole rig, which waits for faults and takes half of one; those of single nodes and others by the clock, which
# mostly wait, many side by side; and those that want the processors for themselves. The others, which only compute, run
# behind all but the last, where a processor is idle.
# Options of pytest may follow.
set -uo pipefail
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again
# To import the other files takes each process of pytest seconds. The files with long tests happen to be the last ones.
with_mark() { grep -rlE "mark\.($1)\b" --include='test_*.py' src tests | sort -r; }
mapfile -t with_rig < <(with_mark rig)
mapfile -t with_full_rate < <(with_mark full_rate)
mapfile -t with_alone < <(with_mark alone)

code=0
run() {  # run MARKERS [PYTEST'S OPTIONS AND FILES]...
  python -m pytest -m "$@" || code=$?
}
log=$(mktemp)
# Any other program that becomes ready takes the processor from one behind it at once. A test may then wait for minutes.
how=idle
chrt --idle 0 true 2> /dev/null || how=19
setsid src/common/shell/behind.sh "$how" python -m pytest -m "not ros and not rig and not clock" -n 2 --dist worksteal -o timeout=1200 "$@" > "$log" 2>&1 &
pure=$!
trap 'kill -- "-$pure" 2> /dev/null; rm -f "$log"' EXIT
trap 'exit 130' INT  # pytest takes Ctrl-C and exits, after which this script would run the next tests
[ "$how" = idle ] || wait "$pure"  # niceness alone leaves them too much beside the demos
run "full_rate and not alone" -n 2 --dist worksteal "$@" "${with_full_rate[@]}"
run "rig and not full_rate and not alone" -n 3 --dist loadgroup "$@" "${with_rig[@]}"
run "(ros or clock) and not rig" -n 6 --dist worksteal --clock-files "$@"
wait "$pure" || code=$?
run alone "$@" "${with_alone[@]}"
cat "$log"
exit "$code"
