"""Folders of the documentation, for the scripts that write into them."""

from pathlib import Path

DOCS = Path(__file__).parents[1]
ROOT = DOCS.parent
STATIC = DOCS / "_static"
"""Pictures of pages."""
GENERATED = DOCS / "_generated"
"""Tables and data that scripts write and pages include."""
