#!/usr/bin/env bash
# Sets the workspace up: Debian packages, a Python environment, the catkin build. Does only what is missing; safe to run again.
# Names of steps as arguments (install_packages, make_environment, build_workspace) run only these, as the Containerfile does.
# Where ROS Noetic is installed or belongs, on Ubuntu 20.04, ROS comes from there, and from Debian's own packages elsewhere.
# LEAP_RIG_LOG names the file that takes the full output (default build/setup.log), LEAP_RIG_NOETIC another place of Noetic.
set -euo pipefail
cd "$(dirname "$0")/.."
here=$(pwd -P)
case $here in *[[:space:]\'\"\`\\\$\&\;\|\<\>\(\)]*)
  echo "The workspace is in '$here', and catkin builds nothing in a path with spaces, quotes or brackets. Move the folder, and run this again." >&2
  exit 1 ;;
esac
# Build and environment hold their own path in many files.
built_in=$(sed -n 's|^CMAKE_HOME_DIRECTORY:INTERNAL=\(.*\)/src$|\1|p' build/CMakeCache.txt 2>/dev/null || true)
if [ -n "$built_in" ] && [ "$built_in" != "$here" ]; then
  echo "The workspace was built in $built_in: it is built anew in $here."
  rm -rf devel .venv
  find build -mindepth 1 -maxdepth 1 ! -name 'soak*' ! -name fuzz ! -name golden ! -name mutants -exec rm -rf {} +
fi
mkdir -p build
log=${LEAP_RIG_LOG:-build/setup.log}
: >"$log"
noetic=${LEAP_RIG_NOETIC:-/opt/ros/noetic}
packages=apt-packages.txt
if [ -e "$noetic" ] || grep -qs '^VERSION_CODENAME=focal$' /etc/os-release; then packages=apt-packages-noetic.txt; fi

if [ -t 1 ]; then clear_line=$'\r\033[K' line_end=''; else clear_line='' line_end=$'\n'; fi
last_shown=-10 shown_at=0

headline() { printf '%s\n' "$1"; last_shown=-10; }

# progress PERCENT TEXT: one line that is overwritten on a terminal; elsewhere a line every tenth, or after 20 s.
progress() {
  local percent=$1 text=$2 bar
  if [ -z "$clear_line" ]; then
    [ $((percent - last_shown)) -ge 10 ] || [ $((SECONDS - shown_at)) -ge 20 ] || return 0
    last_shown=$percent shown_at=$SECONDS
  fi
  printf -v bar '%*s' $((percent / 4)) ''
  printf '%s  [%-25s] %3d %%  %.60s%s' "$clear_line" "${bar// /#}" "$percent" "$text" "$line_end"
}

finished() { printf '%s  %s\n' "$clear_line" "$1"; }

failed() {
  printf '\n%s The last lines of %s:\n' "$1" "$log" >&2
  tail -n 25 "$log" >&2
  exit 1
}

as_root() {
  if [ "$(id -u)" = 0 ]; then "$@"; elif command -v sudo >/dev/null; then sudo "$@"; else
    echo "Installing Debian packages needs root: run this as root, or install sudo." >&2
    exit 1
  fi
}

install_packages() {
  local wanted missing=() package
  wanted=$(sed 's/#.*//' "$packages")
  for package in $wanted; do
    [ "$(dpkg-query -W -f='${db:Status-Status}' "$package" 2>/dev/null)" = installed ] || missing+=("$package")
  done
  headline "1/3 Debian packages, of $packages"
  if [ ${#missing[@]} = 0 ]; then finished "all there"; return; fi
  echo "  to install: ${missing[*]}"
  as_root apt-get update -q >>"$log" 2>&1 || failed "apt-get update failed."
  # apt reports on descriptor 3 in lines kind:package:percent:text; downloading is the first half of the bar.
  { as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends \
      -o APT::Status-Fd=3 -o APT::Sandbox::User=root "${missing[@]}" 3>&1 1>>"$log" 2>&1 || echo "failed:::"; } |
    while IFS=: read -r kind _ percent text; do
      percent=${percent%%.*}
      case $kind in
        dlstatus) progress $((percent / 2)) "$text" ;;
        pmstatus) progress $((50 + percent / 2)) "$text" ;;
        failed) exit 1 ;;
      esac
    done || failed "Installing the Debian packages failed."
  finished "installed ${#missing[@]} packages and what they need"
}

make_environment() {
  headline "2/3 Python environment"
  # Only Debian's own Python sees Debian's rospy.
  .venv/bin/python -m pip --version >>"$log" 2>&1 ||  # interrupted while it was made, it has a Python and no pip
    /usr/bin/python3 -m venv --system-site-packages .venv >>"$log" 2>&1 || failed "Making .venv failed."
  local lists=(requirements.txt requirements-dev.txt) total count=0
  if [ "$packages" = apt-packages-noetic.txt ] && .venv/bin/python -c 'import sys; sys.exit(sys.version_info >= (3, 9))'; then
    lists=(requirements-noetic.txt)
    # The pip of Ubuntu 20.04 does not know today's wheels; this is the last one for Python 3.8.
    .venv/bin/python -m pip install -q pip==25.0.1 >>"$log" 2>&1 || failed "Updating pip in .venv failed."
  fi
  total=$(cat "${lists[@]}" | grep -cE '^[a-zA-Z]')
  { .venv/bin/python -m pip install --disable-pip-version-check "${lists[@]/#/-r}" 2>&1 || echo "pip-failed"; } |
    while IFS= read -r line; do
      echo "$line" >>"$log"
      case $line in
        Collecting*|"Requirement already satisfied"*) count=$((count + 1)); progress $((count < 2 * total ? count * 45 / total : 90)) "$line" ;;
        *Downloading*|*"Building wheel"*) progress $((count < 2 * total ? count * 45 / total : 90)) "${line#"${line%%[! ]*}"}" ;;
        Installing*) progress 95 "installing them, which takes a minute or two" ;;
        pip-failed) exit 1 ;;
      esac
    done || failed "Installing the Python requirements failed."
  progress 97 "MediaPipe, for the webcam tracker"
  .venv/bin/python -m pip install --disable-pip-version-check --no-deps -r requirements-webcam.txt >>"$log" 2>&1 ||
    finished "MediaPipe could not be installed (see $log): the webcam tracker is not available, everything else is."
  finished "ready in .venv"
}

build_workspace() {
  headline "3/3 Workspace build"
  if [ "$packages" = apt-packages-noetic.txt ]; then
    set +u  # the set-up files of ROS read variables that a plain terminal lacks
    # shellcheck source=/dev/null
    source "$noetic/setup.bash"
    set -u
  fi
  { catkin_make --force-cmake -DPYTHON_EXECUTABLE="$PWD/.venv/bin/python" -DCATKIN_ENABLE_TESTING=OFF 2>&1 || echo "build-failed"; } |
    while IFS= read -r line; do
      echo "$line" >>"$log"
      case $line in
        "["*%"]"*) percent=${line#[}; progress $((${percent%%%*})) "${line#*] }" ;;
        build-failed) exit 1 ;;
      esac
    done || failed "The build failed."
  finished "built"
}

[ $# -gt 0 ] || set -- install_packages make_environment build_workspace
for step; do "$step"; done
