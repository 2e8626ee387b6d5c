"""The long description of a distribution: README.md with absolute links; all else: pyproject.toml.

Links and pictures of the README are paths in the repository, which a package index does not have.
"""

import re
import tomllib
from pathlib import Path

from setuptools import setup

project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]


def absolute(link: re.Match[str]) -> str:
    """Return a link of Markdown with the address of its file in the release of this version."""
    form = "raw" if link["text"].startswith("!") else "blob"
    address = f"{project['urls']['Repository']}/{form}/v{project['version']}"
    return f"{link['text']}({address}/{link['path']})"


setup(
    long_description=re.sub(
        r"(?P<text>!?\[[^\]]*\])\((?!https?:)(?P<path>[^)]+)\)",
        absolute,
        Path("README.md").read_text(encoding="utf-8"),
    ),
    long_description_content_type="text/markdown",
)
