"""The rows, one function each; `load` registers all of them."""

from __future__ import annotations

import importlib
import pkgutil

from campaign.trial import ROWS, Row


def load() -> dict[int, Row]:
    """Returns all rows by number."""
    for module in pkgutil.iter_modules(__path__):
        importlib.import_module(f"{__name__}.{module.name}")
    return dict(sorted(ROWS.items()))
