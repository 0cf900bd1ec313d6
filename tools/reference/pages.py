"""The pages that are generated from the source alone, by file name."""

from __future__ import annotations

from tools.reference import (
    commands,
    control_loop,
    engagement,
    episodes,
    evidence,
    faults,
    field_reports,
    launch_files,
    messages,
    parameters,
    recordings,
)

PAGES = {
    "commands.md": commands.page,
    "control-loop.md": control_loop.page,
    "engagement.md": engagement.page,
    "episodes.md": episodes.page,
    "faults.md": faults.page,
    "field-reports.md": field_reports.page,
    "launch.md": launch_files.page,
    "messages.md": messages.page,
    "parameters.md": parameters.page,
    "recordings.md": recordings.page,
    "safety-evidence.md": evidence.page,
}
