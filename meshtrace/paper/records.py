"""Records of the drawn figures, and the name of the index page."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

INDEX = "index.html"


def read_record(path: Path) -> dict[str, Any] | None:
    """Return the record of a figure, None if it is missing or unreadable."""
    try:
        return dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError):
        return None
