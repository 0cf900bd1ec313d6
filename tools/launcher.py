"""`launcher.py roslaunch|roscore ARGUMENTS`: ROS's program as one of this Python, as tests start it. Its XML-RPC server
ends when it is closed; that of the installed program takes a processor until all has ended."""

import sys

import roslaunch

from common.ros.node import end_closed_servers

end_closed_servers()
del sys.argv[0]
roslaunch.main([*sys.argv[:1], "--core", *sys.argv[1:]] if sys.argv[0] == "roscore" else sys.argv)
