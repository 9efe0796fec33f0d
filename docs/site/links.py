"""Lets pages link to what lies beside docs/: tables are pages of the site too, everything else is named, not linked."""

from __future__ import annotations

import posixpath
import re
from typing import Any

UPWARDS = re.compile(r"\[([^\]]*)\]\((\.\./[^)\s]+)\)")


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """Rewrite the links of a page that lead out of docs/."""
    folder = posixpath.dirname(page.file.src_uri)

    def rewrite(match: re.Match[str]) -> str:
        text, target = match.groups()
        path = posixpath.normpath(posixpath.join("docs", folder, target))
        if path.startswith("docs/"):
            return match.group()
        return f"[{text}]({posixpath.relpath(path, folder or '.')})" if path.startswith("results/") else text

    return UPWARDS.sub(rewrite, markdown)
