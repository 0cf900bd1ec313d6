"""The pages that are generated from the source alone, by file name."""

from __future__ import annotations

from tools.reference import commands, control_loop, engagement, launch_files, messages, parameters

PAGES = {
    "commands.md": commands.page,
    "control-loop.md": control_loop.page,
    "engagement.md": engagement.page,
    "launch.md": launch_files.page,
    "messages.md": messages.page,
    "parameters.md": parameters.page,
}
