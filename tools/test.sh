#!/usr/bin/env bash
# All tests: first, side by side, those without the whole rig; then those with it, one at a time, as it fills a small machine.
set -uo pipefail
code=0
python -m pytest -m "not rig" -n 2 --dist loadfile "$@" || code=$?
python -m pytest -m rig "$@" || code=$?
exit $code
