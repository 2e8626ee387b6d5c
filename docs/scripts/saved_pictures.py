"""Image scraper of the gallery: the pictures that a block of an example has saved."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from sphinx_gallery.scrapers import figure_rst


def scraper(block: object, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Move new PNG files beside the script to the built pages, in the order of their creation."""
    folder = Path(block_vars["src_file"]).parent
    directives = ""
    for saved in sorted(folder.glob("*.png"), key=lambda path: path.stat().st_mtime_ns):
        path = next(block_vars["image_path_iterator"])
        shutil.move(saved, path)
        words = saved.stem.replace("_", " ")
        directives += figure_rst([path], gallery_conf["src_dir"], fig_titles=words)
    return directives
