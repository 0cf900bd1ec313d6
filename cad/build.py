"""Exports STEP, STL and drawing of all parts: `python -m cad.build [part ...]` in the project's folder, `make cad`."""

from __future__ import annotations

import importlib
import re
import sys

import cadquery as cq

from cad import manifest
from cad.dimensions import PARTS
from cad.drawing import Sheet

STL_SAGITTA, STL_ANGLE = 0.015, 0.4
SCALES = {"panel_bracket": 0.5, "centring_sleeve": 2.0}


def build(part: str) -> None:
    """Writes the files of one part and notes them in the manifest.

    Raises:
        ValueError: the solid has faults.
    """
    module = importlib.import_module(f"cad.{part}.part")
    solid = module.solid()
    if not solid.val().isValid() or solid.solids().size() != 1:
        raise ValueError(f"{part} is not one valid solid")
    step, stl, svg = manifest.exported(part)
    body = cq.Workplane(solid.solids().val())
    cq.exporters.export(body, str(step), "STEP")
    # The time of the export would make every build another file.
    step.write_text(
        re.sub(r"FILE_NAME\('[^']*','[^']*'", f"FILE_NAME('{part}','2000-01-01T00:00:00'", step.read_text())
    )
    body.val().exportStl(str(stl), STL_SAGITTA, STL_ANGLE, relative=False)
    sheet = Sheet(part, PARTS[part].title, SCALES.get(part, 1.0), "PETG · MIT licence")
    module.draw(body, sheet)
    svg.write_text(sheet.svg())
    manifest.record([step, stl, svg], manifest.sources(part))


def main(names: list[str]) -> None:
    """Builds the named parts, or all of them."""
    unknown = sorted(set(names) - set(PARTS))
    if unknown:
        sys.exit(f"there is no part {', '.join(unknown)}; the parts are {', '.join(PARTS)}")
    for part in names or PARTS:
        build(part)
        print(f"{part}: {', '.join(file.name for file in manifest.exported(part))}")


if __name__ == "__main__":
    main(sys.argv[1:])
