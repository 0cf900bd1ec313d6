#!/bin/sh
# with_screen.sh PROGRAM [ARGUMENT]...: RViz, unless there is no screen: Qt would abort, and ask to be installed again.
python3 -c '
from common.screen import no_window
fault = no_window()
raise SystemExit(f"RViz is not opened: {fault}." if fault else 0)' || exit 1
exec "$@"
