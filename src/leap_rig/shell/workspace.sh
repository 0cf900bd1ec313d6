#!/usr/bin/env bash
# Sourced by the scripts here: makes sure that ROS finds this package. A terminal whose set-up file was sourced is left as
# it is; otherwise the nearest workspace around this folder is taken: a clone of its own, one that holds the clone, or an
# install space.
if ! rospack find leap_rig >/dev/null 2>&1; then
  workspace=$(dirname "$(readlink -f "${BASH_SOURCE[0]}")")
  until [ -e "$workspace/devel/setup.bash" ] || [ -e "$workspace/local_setup.bash" ]; do
    if [ "$workspace" = / ]; then
      echo "No workspace around $(dirname "${BASH_SOURCE[0]}") is built; nothing was started. Build it, or source its setup.bash." >&2
      exit 1
    fi
    workspace=$(dirname "$workspace")
  done
  [ ! -e "$workspace/devel/setup.bash" ] || workspace=$workspace/devel
  # shellcheck source=/dev/null
  source "$workspace/setup.bash"
fi
