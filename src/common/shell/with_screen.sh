#!/bin/sh
# with_screen.sh PROGRAM [ARGUMENT]...: RViz beside the control panel, unless there is no screen: Qt would abort, and ask
# to be installed again.
exec python3 -c 'from common.ros.rviz import main; main()' "$@"
