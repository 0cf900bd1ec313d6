#!/usr/bin/env bash
# Starts the Leap service that is installed, and says which: today's (Gemini or Hyperion, with the vendor's separate
# WebSocket server) or leapd 2.3; with --sim the simulated one (further arguments go to it; --help lists them).
set -euo pipefail
unit=ultraleap-hand-tracking-service
page=docs/handbook/ultraleap.md

has() { command -v "$1" >/dev/null; }
# leapd 2.3 writes below /root and opens its WebSocket only as root; a system service starts only as root.
if [ "$(id -u)" = 0 ]; then as_root=(); else as_root=(sudo); fi

if [ "${1:-}" = --sim ]; then
  shift
  set +u  # the set-up files of ROS read variables that a plain terminal lacks
  source "$(dirname "$(readlink -f "$0")")/workspace.sh"
  exec rosrun rig_simulation leapd.py "$@"
fi
if has Ultraleap-Tracking-WS; then
  echo "Today's Ultraleap software: tracking service and UltraleapTrackingWebSocket, port 6437."
  systemctl is-active --quiet "$unit" || "${as_root[@]}" systemctl start "$unit" || {
    echo "The tracking service ($unit) does not start. See \`systemctl status $unit\` and $page." >&2
    exit 1
  }
  exec Ultraleap-Tracking-WS "$@"
fi
if has leapctl; then  # its leapd has no WebSocket
  echo "Ultraleap's tracking service is installed, but not its WebSocket server (Ultraleap-Tracking-WS)." >&2
  echo "Build it, and put it on the PATH: $page." >&2
  exit 1
fi
if has leapd; then
  echo "Leap service 2.3: leapd, port 6437."
  exec "${as_root[@]}" leapd "$@"
fi
echo "No Leap service is installed: neither leapd 2.3 nor Ultraleap-Tracking-WS. Install one ($page)," >&2
echo "use another tracker, or run $(basename "$0") --sim." >&2
exit 1
