"""The sheets of tags as PDF in true scale: `python -m cad.tag_sheets.sheets` in the project's folder, by `make cad`.

All lengths in mm from the lower left corner of the paper. What is black is made of rectangles with exact edges, so that
no printer dialog and no renderer has pixels to scale.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from cad import dimensions as d

FOLDER = Path(__file__).parent
sys.path.append(str(FOLDER.parents[1] / "src/common/src"))

from common.tag36h11 import CELLS, black_cells  # noqa: E402

POINTS_PER_MM = 72.0 / 25.4
THIN = 0.15


class Page:
    """One page of a PDF file.

    Args:
        size: width and height.
    """

    def __init__(self, size: tuple[float, float]) -> None:
        self._size, self._content = size, [f"{POINTS_PER_MM:.9f} 0 0 {POINTS_PER_MM:.9f} 0 0 cm", f"{THIN} w"]

    def rectangles(self, boxes) -> None:
        """Blackens boxes (x, y, width, height), as one shape."""
        self._content += [f"{x:.4f} {y:.4f} {w:.4f} {h:.4f} re" for x, y, w, h in boxes]
        self._content.append("f")

    def line(self, *points: tuple[float, float]) -> None:
        """Draws a thin line through points."""
        path = [f"{x:.4f} {y:.4f} {'l' if i else 'm'}" for i, (x, y) in enumerate(points)]
        self._content += [*path, "S"]

    def text(self, x: float, y: float, text: str, size: float = 3.5) -> None:
        """Writes text of a height in mm."""
        escaped = text.replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
        self._content.append(f"BT /F1 {size} Tf {x:.2f} {y:.2f} Td ({escaped}) Tj ET")

    def pdf(self) -> bytes:
        """Returns the file."""
        content = "\n".join(self._content).encode("cp1252")
        width, height = (POINTS_PER_MM * edge for edge in self._size)
        objects = [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {width:.4f} {height:.4f}] /Contents 4 0 R "
            f"/Resources << /Font << /F1 5 0 R >> >> >>".encode(),
            b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica /Encoding /WinAnsiEncoding >>",
        ]
        file, offsets = b"%PDF-1.6\n", []
        for i, body in enumerate(objects, 1):
            offsets.append(len(file))
            file += b"%d 0 obj\n%s\nendobj\n" % (i, body)
        table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
        end = b"trailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n" % (len(objects) + 1, len(file))
        return file + b"xref\n0 %d\n0000000000 65535 f \n" % (len(objects) + 1) + table + end


def tag_boxes(tag: int, size: float, centre: tuple[float, float]) -> list[tuple[float, float, float, float]]:
    """Returns the black cells of a tag as boxes: runs along the rows and along the columns, so that no seam shows."""
    cell, boxes = size / CELLS, []
    left, top = centre[0] - size / 2, centre[1] + size / 2
    for grid, upright in ((black_cells(tag), False), (black_cells(tag).T, True)):
        for i, cells in enumerate(grid):
            edges = np.flatnonzero(np.diff(np.concatenate([[0], cells.astype(int), [0]]))).reshape(-1, 2)
            for start, end in edges:
                if upright:
                    boxes.append((left + i * cell, top - end * cell, cell, (end - start) * cell))
                else:
                    boxes.append((left + start * cell, top - (i + 1) * cell, (end - start) * cell, cell))
    return boxes


def single() -> bytes:
    """Returns the sheet of the single tag, A4."""
    page, centre = Page(d.A4), (105.0, 205.0)
    page.rectangles(tag_boxes(0, d.SINGLE_TAG, centre))
    _cut(page, centre, d.SINGLE_PLATE)
    _rulers(page, (70.0, 100.0), (35.0, 20.0))
    lines = (f"Tag 0 of tag36h11, black square {d.SINGLE_TAG:g} mm.", "Cut along the square, stick it on marker_plate.")
    _explain(page, (70.0, 85.0), lines)
    return page.pdf()


def panel() -> bytes:
    """Returns the sheet of the five tags, A3."""
    page, centre = Page(d.A3), (148.5, 148.5)
    for tag, size, x, y in d.PANEL_TAGS:
        page.rectangles(tag_boxes(tag, size, (centre[0] + x, centre[1] + y)))
    for x, y in d.PANEL_SCREWS:
        x, y = centre[0] + x, centre[1] + y
        page.line((x - 3, y), (x + 3, y))
        page.line((x, y - 3), (x, y + 3))
    _cut(page, centre, d.PANEL_SHEET)
    _rulers(page, (305.0, 250.0), (310.0, 20.0))
    sizes = [f"Tag {tag} of tag36h11: {size:g} mm." for tag, size, _, _ in d.PANEL_TAGS]
    glue = (
        "Cut along the square, stick it in the middle",
        "of the plate of 300 x 300 mm, then drill",
        "4.5 mm through the four crosses.",
    )
    _explain(page, (322.0, 225.0), (*sizes, *glue))
    return page.pdf()


def _cut(page: Page, centre: tuple[float, float], edge: float) -> None:
    x0, y0, x1, y1 = centre[0] - edge / 2, centre[1] - edge / 2, centre[0] + edge / 2, centre[1] + edge / 2
    page.line((x0, y0), (x1, y0), (x1, y1), (x0, y1), (x0, y0))
    # The upper edge, which points away from the flange, stays known when the sheet is cut out.
    page.rectangles([(centre[0] - 2.0, y1 - 1.2, 4.0, 1.2)])


def _rulers(page: Page, horizontal: tuple[float, float], vertical: tuple[float, float]) -> None:
    for (x, y), (dx, dy) in ((horizontal, (1, 0)), (vertical, (0, 1))):
        page.line((x, y), (x + d.RULER * dx, y + d.RULER * dy))
        for i in range(0, round(d.RULER) + 1, 5):
            tick = 4.0 if i % 50 == 0 else 2.5 if i % 10 == 0 else 1.5
            page.line((x + i * dx, y + i * dy), (x + i * dx - tick * dy, y + i * dy + tick * dx))


def _explain(page: Page, place: tuple[float, float], lines) -> None:
    text = (
        "Print at 100 %, not fitted to the page.",
        f"Both rulers must measure {d.RULER:g} mm: along and across.",
        "Measure the black squares too.",
        *lines,
        "The bar at the edge points away from the flange.",
    )
    for i, line in enumerate(text):
        page.text(place[0], place[1] - 6.0 * i, line)


FILES = {"single_a4.pdf": single, "panel_a3.pdf": panel}
"""What makes each file."""

if __name__ == "__main__":
    for name, sheet in FILES.items():
        (FOLDER / name).write_bytes(sheet())
        print(name)
