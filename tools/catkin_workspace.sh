#!/usr/bin/env bash
# The project in a catkin workspace of somebody else's: a clone beside a foreign package, built, and the simulated demo
# run there while a node of the foreign package listens.
#   tools/catkin_workspace.sh catkin_make|catkin_build|install FOLDER [--environment]
# FOLDER becomes the workspace. `install` also installs, and moves sources, build and devel space away before the demo.
# With --environment the clone gets its .venv; otherwise the Python packages are those of the first python3 on the PATH.
# The exit code is the demo's, or 3 if the foreign node heard nothing.
set -euo pipefail
project=$(cd "$(dirname "$0")/.." && pwd -P)
way=${1:-} workspace=${2:-} environment=${3:-}
case $way:$environment in
  catkin_make: | catkin_build: | install: | catkin_make:--environment | catkin_build:--environment | install:--environment) ;;
  *) way= ;;
esac
if [ -z "$way" ] || [ -z "$workspace" ]; then
  sed -n '4,7p' "$0" >&2
  exit 2
fi
mkdir -p "$workspace/src/lab_arm/msg" "$workspace/src/lab_arm/scripts"
cd "$workspace"

# Each step with the time that it took.
timed() {
  local name=$1 start=$SECONDS
  shift
  "$@" >"$name.log" 2>&1 || { tail -n 30 "$name.log" >&2; echo "$way: $name failed." >&2; exit 1; }
  echo "$way: $name took $((SECONDS - start)) s."
}

timed clone git clone -q "$project" src/leap_rig
cat >src/lab_arm/package.xml <<'END'
<?xml version="1.0"?>
<package format="3">
  <name>lab_arm</name>
  <version>0.1.0</version>
  <description>A foreign package: how high the tool is.</description>
  <maintainer email="lab@example.invalid">A lab</maintainer>
  <license>MIT</license>
  <buildtool_depend>catkin</buildtool_depend>
  <build_depend>message_generation</build_depend>
  <exec_depend>message_runtime</exec_depend>
  <exec_depend>rospy</exec_depend>
  <exec_depend>sensor_msgs</exec_depend>
</package>
END
cat >src/lab_arm/CMakeLists.txt <<'END'
cmake_minimum_required(VERSION 3.10)
project(lab_arm)
find_package(catkin REQUIRED COMPONENTS message_generation)
add_message_files(FILES Joints.msg)
generate_messages()
catkin_package(CATKIN_DEPENDS message_runtime)
catkin_install_python(PROGRAMS scripts/joints.py DESTINATION ${CATKIN_PACKAGE_BIN_DESTINATION})
END
echo "float64[] positions" >src/lab_arm/msg/Joints.msg
cat >src/lab_arm/scripts/joints.py <<'END'
#!/usr/bin/env python3
import rospy
from lab_arm.msg import Joints
from sensor_msgs.msg import JointState

rospy.init_node("lab_joints")
publisher = rospy.Publisher("lab/joints", Joints, queue_size=1)
for _ in range(100):
    publisher.publish(Joints(positions=rospy.wait_for_message("joint_states", JointState).position))
print("lab_arm heard 100 joint states.")
END
chmod +x src/lab_arm/scripts/joints.py

python=()
if [ "$environment" = --environment ]; then
  timed environment make -C src/leap_rig environment
  python=("-DPYTHON_EXECUTABLE=$PWD/src/leap_rig/.venv/bin/python")
fi
case $way in
  catkin_make) timed build catkin_make "${python[@]}" ;;
  install) timed build catkin_make "${python[@]}" install ;;
  catkin_build)
    catkin config --init ${python:+--cmake-args "${python[@]}"} >config.log
    timed build catkin build --no-status
    ;;
esac
space=devel
if [ "$way" = install ]; then
  space=install
  mkdir away
  mv src build devel away
  # The one thing of the clone that is still used; it works in its own place alone.
  [ -z "$environment" ] || { mkdir -p src/leap_rig && mv away/src/leap_rig/.venv src/leap_rig; }
fi

set +u # the set-up files of ROS read variables that a plain terminal lacks
# shellcheck source=/dev/null
source "$space/setup.bash"
set -u
rosrun lab_arm joints.py >lab_arm.log 2>&1 &
foreign=$!
trap 'kill "$foreign" 2>/dev/null || true' EXIT
# Three minutes: on a busy machine the first hand may be lost before it closes.
start=$SECONDS code=0
rosrun leap_rig demo.py --headless --duration 180 --report "$PWD/report.json" 2>&1 | tee demo.log | tail -n 25 || code=$?
echo "$way: the demo took $((SECONDS - start)) s and ended with $code; all together $SECONDS s."
[ "$code" = 0 ] || exit "$code"
grep -q "heard 100" lab_arm.log || { cat lab_arm.log >&2; exit 3; }
echo "$way: the foreign node heard the arm."
