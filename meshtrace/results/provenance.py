"""Provenance of a result: versions, commit, link, surface and run."""

from __future__ import annotations

import os
import platform
import subprocess
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from meshtrace.checks import check_call
from meshtrace.models import Model
from meshtrace.optics.water import Water


@check_call
@cache
def environment() -> dict[str, str]:
    """Return the versions of the software behind a result."""
    programs = {
        "meshtrace": version("meshtrace"),
        "git_commit": _git_commit(Path(__file__).parents[2]),
        "python": platform.python_version(),
        "machine": platform.machine(),
    }
    return programs | {name: _version(name) for name in ("numpy", "numba", "embreex", "scipy")}


def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:  # embreex, where it has no wheel
        return "none"


@check_call
def provenance(link: Model, surface: dict[str, Any], run: dict[str, Any]) -> dict[str, Any]:
    """Return versions, link, surface and run of a result as plain data."""
    return {
        "environment": environment(),
        "link": link.model_dump(mode="json"),
        "surface": surface,
        "run": run,
    }


def water_of(provenance: dict[str, Any]) -> str:
    """Return a, b, wavelength and source of the water of a result as a line of text."""
    link = provenance["link"]
    fields = ("a", "b", "layers", "spectrum", "wavelength_nm")
    water = Water.model_validate({name: link["water"].get(name) for name in fields})
    sources = link["transmitter"]
    source = sources[0] if isinstance(sources, list) else sources
    return water.described(source["wavelength_nm"])


def _git_commit(root: Path) -> str:
    """Return the commit of a checkout of this package, "unknown" for other folders."""
    # an installed package may lie in the repository of another project
    project = root / "pyproject.toml"
    if not project.is_file() or 'name = "meshtrace"' not in project.read_text(encoding="utf-8"):
        return "unknown"
    # variables of a hook of git would point to the repository of that hook
    outside = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(
            ["git", "rev-parse", "--show-toplevel", "HEAD"],
            cwd=root,
            env=outside,
            capture_output=True,
            text=True,
            timeout=5,
            check=True,
        )
    except (OSError, subprocess.SubprocessError):
        return "unknown"
    top, commit = done.stdout.splitlines()
    return commit if Path(top).resolve() == root.resolve() else "unknown"
