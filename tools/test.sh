#!/usr/bin/env bash
# All tests: those without ROS, on the processor alone; those of single nodes, many side by side, as they mostly wait;
# those of the whole rig, one at a time, as it fills a small machine. Options of pytest may follow.
set -uo pipefail
export PYTHONDONTWRITEBYTECODE=  # hundreds of nodes start: each would compile its modules again

code=0
run() {  # run MARKERS [PYTEST'S OPTIONS]...
  python -m pytest -m "$@" || code=$?
}
run "not ros and not rig" -n 2 --dist worksteal "$@"
run "ros and not rig" -n 4 --dist worksteal "$@"
run rig "$@"
exit "$code"
