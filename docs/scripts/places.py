"""Folders of the documentation, for the scripts that write into them."""

from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
STATIC = DOCS / "_static"
"""Pictures of pages."""
GENERATED = DOCS / "_generated"
"""Tables and data that scripts write and pages include."""


def write_table(name: str, text: str) -> None:
    """Write a table that a page includes."""
    (GENERATED / f"{name}_table.md").write_text(f"{text}\n", encoding="utf-8")
