#!/usr/bin/env bash
# Starts the Leap service: the real one, or with --sim the simulated one (further arguments go to it; --help lists them).
set -eo pipefail
source "$(dirname "$(readlink -f "$0")")/../../../devel/setup.bash"
set -u  # not before: the set-up files of ROS read variables that a plain terminal lacks
if [ "${1:-}" = --sim ]; then
  shift
  exec rosrun rig_simulation leapd.py "$@"
fi
command -v leapd >/dev/null || {
  echo "The Leap service (leapd) is not installed. Install the Leap Motion SDK, or run $(basename "$0") --sim." >&2
  exit 1
}
# The service writes its settings below /root and opens its WebSocket only as root.
if [ "$(id -u)" = 0 ]; then
  exec leapd "$@"
fi
exec sudo leapd "$@"
