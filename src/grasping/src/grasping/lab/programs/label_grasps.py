"""Draw grasps on depth images with the mouse, for import_grasps.py: from finger to finger; stored at once.

The folder holds 16-bit images in millimetres, or .npy or .tiff files in metres (depth_images.py takes them from a bag).
Beside each labelled image NAME lies NAME.grasps.json afterwards.
"""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from common.errors import DeviceError, RigError
from common.screen import check_screen
from grasping.lab.dataset.labelled_images import depth_images


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="of the depth images")
    arguments = parser.parse_args()
    try:
        images = depth_images(arguments.folder)
    except RigError as error:
        parser.error(str(error))
    except OSError as error:
        parser.error(f"{error.filename}: {error.strerror}.")
    try:
        check_screen("The window")
    except DeviceError as error:
        sys.exit(f"label_grasps: {error}")
    from python_qt_binding.QtWidgets import QApplication

    from grasping.lab.label_window import LabelWindow

    application = QApplication(sys.argv[:1])
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # Qt's loop runs no Python: Ctrl-C ends it here; nothing is unsaved
    window = LabelWindow(images)
    window.show()
    sys.exit(application.exec_())
