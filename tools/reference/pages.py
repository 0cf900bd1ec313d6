"""The generated pages that follow from the source alone, by their file's name."""

from __future__ import annotations

from tools.reference import commands, errors, launch_files, messages, modules, parameters

PAGES = {
    "commands.md": commands.page,
    "errors.md": errors.page,
    "launch.md": launch_files.page,
    "messages.md": messages.page,
    "modules.md": modules.page,
    "parameters.md": parameters.page,
}
