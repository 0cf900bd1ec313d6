#!/usr/bin/env bash
# All tests. Those that go by the clock, one part after another: demos at the rates of the real rig, which take most of
# a processor; those of the whole rig, which waits for faults and takes half of one; those of single nodes, sockets and
# threads, which mostly wait, many side by side; and those that want the processors for themselves. `make test-fast`,
# whose tests only compute, runs behind the first three, where a processor is idle; then what computes with messages.
# At the end, what failed and goes by the clock is run once more.
# Options of pytest may follow.
set -uo pipefail
cd "$(dirname "$0")/.." || exit
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again
folder=$(mktemp -d)
trap 'exit 130' INT  # pytest takes Ctrl-C and exits, after which this script would run the next tests

# Any other program that becomes ready takes the processor from one behind it at once. A test may then wait for minutes.
how=idle
chrt --idle 0 true 2> /dev/null || how=19
options="${*@Q}"
PYTEST_ADDOPTS="-o timeout=1200 ${PYTEST_ADDOPTS:-} $options" \
  setsid src/common/shell/behind.sh "$how" make --no-print-directory test-fast > "$folder/log" 2>&1 &
pure=$!
trap 'kill -- "-$pure" 2> /dev/null; rm -rf "$folder"' EXIT
[ "$how" = idle ] || wait "$pure"  # niceness alone leaves them too much beside the demos

set +u
# shellcheck source=/dev/null
source devel/setup.bash || exit
set -u
# To import the other files takes each process of pytest seconds. The files with long tests happen to be the last ones.
with_mark() { grep -rlE "mark\.($1)\b" --include='test_*.py' src tests | sort -r; }
mapfile -t with_ros < <(with_mark ros)
mapfile -t with_rig < <(with_mark rig)
mapfile -t with_full_rate < <(with_mark full_rate)
mapfile -t with_alone < <(with_mark alone)

code=0
run() {  # run MARKERS [PYTEST'S OPTIONS AND FILES]...
  # with a `=`, as pytest takes its root folder from paths among its words
  python -m pytest -p tools.second_try --failures="$folder/failed" -m "($1) and not long" "${@:2}" || code=$?
}
run "full_rate and not alone" -n 2 --dist worksteal "$@" "${with_full_rate[@]}"
run "rig and not full_rate and not alone" -n 3 --dist loadgroup "$@" "${with_rig[@]}"
run "clock and not rig" -n 6 --dist worksteal --clock-files "$@"
wait "$pure" || code=$?
cat "$folder/log"
run "ros and not clock and not rig" -n 2 --dist worksteal "$@" "${with_ros[@]}"
run alone "$@" "${with_alone[@]}"
python -m tools.second_try "$folder/failed" "$@" || code=$?
exit "$code"
