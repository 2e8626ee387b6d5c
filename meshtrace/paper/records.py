"""Records of the drawn figures, and the name of the index page."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

from meshtrace.files import atomic

INDEX = "index.html"


def write_record(path: Path, record: dict[str, Any]) -> None:
    """Write a record with its SHA-256 digest, atomically."""
    content = {**record, "digest": digest(record)}
    with atomic(path) as temporary:
        temporary.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


def read_record(path: Path) -> dict[str, Any] | None:
    """Return the record of a figure, None if it is missing or damaged."""
    try:
        record = dict(json.loads(path.read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return None
    return record if record.pop("digest", None) == digest(record) else None


def digest(record: dict[str, Any]) -> str:
    """Return the SHA-256 digest of a record."""
    return hashlib.sha256(json.dumps(record, sort_keys=True).encode()).hexdigest()
