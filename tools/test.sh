#!/usr/bin/env bash
# All tests, one part after another: `make test-fast`, which needs no ROS; nodes and whole rigs in virtual time; those
# by the real clock, which have the processors for themselves. With --long as the first word: what is left for a release.
# Options of pytest may follow; those that choose tests must leave some in each part.
set -uo pipefail
cd "$(dirname "$0")/.." || exit
trap 'exit 130' INT  # pytest takes Ctrl-C and exits, after which this script would run the next tests

parts=("ros and not real and not long" "real and not long")
if [ "${1:-}" = --long ]; then
  shift
  parts=(long)
fi
code=0
if [ "${parts[0]}" != long ]; then
  PYTEST_ADDOPTS="${PYTEST_ADDOPTS:-} ${*@Q}" make --no-print-directory test-fast || code=$?
fi
# shellcheck source=/dev/null
set +u && source devel/setup.bash || exit
set -u
for part in "${parts[@]}"; do
  # To import the other files takes each process of pytest seconds. The files with the slowest tests happen to be the last ones.
  mapfile -t files < <(grep -rlE "mark\.${part%% *}\b" --include='test_*.py' src tests | sort -r)
  workers=$(nproc)
  [ "${part%% *}" = ros ] || workers=2
  python -m pytest -n "$workers" --dist worksteal -m "$part" "$@" "${files[@]}" || code=$?
done
exit "$code"
