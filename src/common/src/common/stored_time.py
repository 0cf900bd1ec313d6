"""Moments in files and their names: UTC, so that their order is that of the events in every time zone."""

from __future__ import annotations

from datetime import datetime, timezone


def utc(seconds: float) -> str:
    """Returns a moment [s since 1970] as 2026-01-31T12:00:00Z."""
    return datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%dT%H:%M:%SZ")


def moment(text: str) -> float:
    """Returns the moment [s since 1970] of a text as `utc` writes it, or with another zone as +01:00. Without a zone,
    as earlier files have it, it is in this computer's zone. Raises ValueError for another text."""
    zoned = f"{text[:-1]}+00:00" if text.endswith("Z") else text
    return datetime.fromisoformat(zoned).timestamp()
