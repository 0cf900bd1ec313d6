"""Generates the pages of docs/reference from the source: `python -m tools.reference`. A test compares both. Each module
makes one page and has `page() -> str`."""
