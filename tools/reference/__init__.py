"""Writes the pages of docs/reference from the source: `python -m tools.reference`; a test fails when a page is out of date.

Each module makes one page and has `page() -> str`.
"""
