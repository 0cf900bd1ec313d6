"""Writes the generated pages of docs/reference."""

from __future__ import annotations

from tools.reference.pages import PAGES
from tools.reference.sources import REFERENCE

for name, make in PAGES.items():
    (REFERENCE / name).write_text(make())
