"""What a launch file would start, found within this process: a start of roslaunch for each question costs a second."""

from __future__ import annotations

import shlex
from typing import Any

import roslaunch


def nodes(package: str, file: str, *arguments: str) -> set[str]:
    """Returns the names of the nodes that the launch file starts with these arguments (name:=value)."""
    return set(roslaunch.node_args.get_node_list(config(package, file, arguments)))


def prefixes(package: str, file: str, *arguments: str) -> list[str]:
    """Returns what each node is started by (launch-prefix), in the order of their start; "" for most."""
    return [node.launch_prefix or "" for node in config(package, file, arguments).nodes]


def command_line(package: str, file: str, node: str, *arguments: str) -> list[str]:
    """Returns the words that a node gets."""
    (found,) = (one for one in config(package, file, arguments).nodes if one.name == node)
    return shlex.split(found.args)


def parameters(package: str, file: str, *arguments: str) -> dict[str, Any]:
    """Returns the parameters that it sets, by their names."""
    return {name: parameter.value for name, parameter in config(package, file, arguments).params.items()}


def config(package: str, file: str, arguments: tuple[str, ...]) -> Any:
    """Loads the file without that of roscore, for which roslaunch starts two programs each time."""
    (path,) = roslaunch.rlutil.resolve_launch_arguments([*filter(None, [package]), file])
    config, loader = roslaunch.config.ROSLaunchConfig(), roslaunch.xmlloader.XmlLoader()
    loader.ignore_unset_args = False
    loader.load(path, config, argv=list(arguments), verbose=False)
    return config
