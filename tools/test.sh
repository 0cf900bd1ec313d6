#!/usr/bin/env bash
# All tests: first, side by side, those without the whole rig; then those with it, one at a time, as it fills a small machine.
# What fails is tried once more, alone: the real time-outs of nodes can still expire on a machine that is busy otherwise.
set -uo pipefail

run() {  # run MARKERS [PYTEST'S OPTIONS]...
  local markers=$1 code=0
  shift
  python -m pytest -m "$markers" "$@" || code=$?
  [ $code -eq 1 ] || return $code  # the other codes of pytest mean that it could not run
  echo "Once more, one at a time, what failed. A test that passes only now is a fault to look for, of the test or of the code."
  python -m pytest -m "$markers" --last-failed --last-failed-no-failures none
}

code=0
run "not rig" -n 3 --dist loadfile "$@" || code=$?
run rig "$@" || code=$?
exit $code
