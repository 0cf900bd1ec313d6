"""Hooks of mkdocs: changes that the site needs but the repository's web page does not."""

from __future__ import annotations

import posixpath
import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

LINK = re.compile(r"(?<!!)\[([^\]]*)\]\(((?:\.\./)+[^)\s]*)\)")


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """Replaces each pattern in the navigation by its pages."""
    if config.nav is not None:
        config.nav = _expanded(config.nav, Path(config.docs_dir))
    return config


def on_page_markdown(markdown: str, page: Page, config: MkDocsConfig, files: Files) -> str:
    """Replaces links to files outside docs/, which are not part of the site, by their paths in the repository."""
    folder = posixpath.dirname(page.file.src_uri)

    def replaced(match: re.Match) -> str:
        target = posixpath.normpath(posixpath.join("docs", folder, match[2].split("#")[0]))
        if target.startswith("docs/"):
            return match[0]
        named = match[1].strip("`") in (target, posixpath.basename(target))
        return f"`{target}`" if named else f"{match[1]} (`{target}`)"

    return LINK.sub(replaced, markdown)


def _expanded(nav: list, docs: Path) -> list:
    """Returns the navigation with patterns such as `folder/*.md` replaced by the matching pages, the README first."""
    expanded = []
    for item in nav:
        title, target = next(iter(item.items())) if isinstance(item, dict) else (None, item)
        if isinstance(target, list):
            pages = _expanded(target, docs)
        elif "*" in target:
            found = sorted(docs.glob(target), key=lambda p: (p.name != "README.md", p.name))
            pages = [str(page.relative_to(docs)) for page in found]
        else:
            expanded.append(item)
            continue
        expanded += [{title: pages}] if title else pages
    return expanded
