"""Blocks of code in Markdown pages, as the tests of the documentation take them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PAGES = (ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md")))
_BLOCK = re.compile(r"^```([^\n]*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_TITLE = re.compile(r'title="([^"]*)"')


@dataclass(frozen=True)
class Block:
    """A fenced block: language, title (the file that a reader would save it as), text."""

    page: Path
    number: int
    language: str
    title: str
    text: str

    def __str__(self) -> str:
        return f"{self.page.name} {self.number} {self.title or self.language or 'text'}"


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page, in order."""
    found = []
    for number, match in enumerate(_BLOCK.finditer(page.read_text(encoding="utf-8")), 1):
        head = match[1].strip()
        title = _TITLE.search(head)
        language = head.split(" ")[0] if head else ""
        found.append(Block(page, number, language, title[1] if title else "", match[2]))
    return found


def of(language: str) -> list[Block]:
    """Return every block of a language, over all pages."""
    return [block for page in PAGES for block in blocks(page) if block.language == language]
