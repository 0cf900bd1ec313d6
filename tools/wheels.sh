#!/usr/bin/env bash
# Wheels of the modules that need no ROS, into build/wheels, or a folder that is named from the root of the repository.
# They are made from copies, because a build leaves files beside its source.
set -euo pipefail
cd "$(dirname "$0")/.."
folder=${1:-build/wheels} copies=$(mktemp -d)
trap 'rm -rf "$copies"' EXIT
rm -f "$folder"/leap_rig_*.whl
for project in src/modules/*/pyproject.toml; do
  module=$(basename "$(dirname "$project")")
  cp -RL "src/modules/$module" "$copies"
  rm -rf "$copies/$module"/{build,src/*.egg-info}
  .venv/bin/python -m build --wheel --outdir "$folder" "$copies/$module" &>"$copies/log" ||
    { cat "$copies/log" >&2; exit 1; }
done
ls "$folder"/leap_rig_*.whl
