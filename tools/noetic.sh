#!/usr/bin/env bash
# Tests on Python 3.8, that of ROS Noetic, in .venv-noetic: those that only compute. With --ros as the first word instead:
# Debian's ROS under Python 3.8, nodes and whole rigs in virtual time, and the demo. Other words go to pytest.
set -euo pipefail
cd "$(dirname "$0")/.."
here=$(pwd -P)
environment=$here/.venv-noetic build=$here/build/noetic debian=/usr/lib/python3/dist-packages

python=
for candidate in python3.8 "${PYENV_ROOT:-$HOME/.pyenv}"/versions/3.8.*/bin/python3.8; do
  if "$candidate" -c 'import ctypes, ensurepip, ssl, sys; sys.exit(sys.version_info[:2] != (3, 8))' &>/dev/null; then
    python=$candidate
    break
  fi
done
if [ -z "$python" ]; then
  echo "No Python 3.8 was found on the PATH or under pyenv: the tests on Python 3.8 are skipped."
  exit 0
fi

# install LIST COMMAND...: what a list names, unless the same list is installed.
install() {
  local list=$1 stamp
  stamp=$environment/$(basename "$list")
  cmp -s "$list" "$stamp" && return
  echo "Installing $(basename "$list") into .venv-noetic"
  "$environment/bin/python" -m pip install -q --disable-pip-version-check -r "$list"
  cp "$list" "$stamp"
}

if ! "$environment/bin/python" -m pip --version &>/dev/null; then
  rm -rf "$environment"
  "$python" -m venv "$environment"
  "$environment/bin/python" -m pip install -q --disable-pip-version-check pip==25.0.1  # the last one for Python 3.8
fi
install requirements-noetic.txt

if [ "${1:-}" != --ros ]; then
  # Fewer examples: `make test` tries the same laws with all of them.
  HYPOTHESIS_TIMES=${HYPOTHESIS_TIMES:-0.2} exec "$environment/bin/python" -m pytest -n "$(nproc)" --dist worksteal \
    -m "not ros and not real and not long" "$@"
fi
shift

if [ ! -d "$debian/rospy" ]; then
  echo "ROS is not installed as Debian's packages: run make setup; on Ubuntu 20.04, whose Python is 3.8, run make test instead." >&2
  exit 1
fi
mkdir -p "$here/build"
# What Debian's ROS takes from Debian's Python 3.11, from PyPI.
printf '%s\n' rospkg==1.4.0 catkin-pkg==0.5.2 defusedxml==0.7.1 docutils==0.19 empy==3.3.4 netifaces==0.11.0 \
  pycryptodomex==3.11.0 python-gnupg==0.4.9 PyQt5==5.15.9 PyQt5-Qt5==5.15.2 PyQt5-sip==12.11.1 >"$here/build/ros.txt"
install "$here/build/ros.txt"
# ROS's own packages are Python alone, and their programs name Debian's Python.
mkdir -p "$environment/ros/tf2_py"
dpkg-query -W -f='${source:Package} ${Package}\n' | sed -n 's/^ros-[^ ]* //p' | xargs dpkg-query -L |
  sed -n "s|^$debian/\([a-z0-9_]*\)/__init__.py$|\1|p" | grep -vE '^(tf2_py|rosdep2)$' |
  while read -r package; do ln -sfn "$debian/$package" "$environment/ros/$package"; done
# This one is compiled, for Python 3.11. It calls only what Python 3.8 has too, and loads there under this name.
cp "$debian/tf2_py/__init__.py" "$environment/ros/tf2_py/"
cp "$debian"/tf2_py/_tf2.cpython-*.so "$environment/ros/tf2_py/_tf2.so"
export PYTHONPATH=$environment/ros
for program in /usr/bin/ros*; do
  if head -c 100 "$program" | grep -qa '^#!.*python'; then
    sed "1s|.*|#!$environment/bin/python|" "$program" >"$environment/bin/$(basename "$program")"
    chmod +x "$environment/bin/$(basename "$program")"
  fi
done

export PATH=$environment/bin:$PATH
catkin_make --build "$build" -DCATKIN_DEVEL_PREFIX="$build/devel" -DPYTHON_EXECUTABLE="$environment/bin/python" \
  -DCATKIN_ENABLE_TESTING=OFF >"$here/build/noetic.log" 2>&1 ||
  { tail -n 25 "$here/build/noetic.log" >&2; echo "The build for Python 3.8 failed." >&2; exit 1; }
set +u
# shellcheck source=/dev/null
source "$build/devel/setup.bash"
set -u
export PATH=$environment/bin:$PATH  # before the workspace's own environment
export ROS_PACKAGE_PATH=$ROS_PACKAGE_PATH:/usr/share  # Debian's rospkg knows it, that of PyPI does not
code=0
mapfile -t files < <(grep -rlE 'mark\.ros\b|importorskip' --include='test_*.py' src tests | sort -r)
python -m pytest -n "$(nproc)" --dist worksteal -m "not real and not long" "$@" "${files[@]}" || code=$?
"$build/devel/lib/leap_rig/demo.py" --headless --duration 20 || code=$?
exit "$code"
