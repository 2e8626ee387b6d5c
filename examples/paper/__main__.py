"""Redraw the figures of the paper, with data, tables and an index page.

python examples/paper [-o FOLDER] [--quick] [--only NAME ...]   # all options: --help

Finished figures are kept; an interrupted run resumes.
"""

import argparse
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).parents[1]))

from meshtrace.errors import Refused
from paper.registry import FIGURES, Setting
from paper.runner import INDEX, make_figures


def main(arguments: list[str] | None = None) -> None:
    """Draw the figures that the arguments name."""
    head, *_ = str(__doc__).partition("\n")
    parser = argparse.ArgumentParser("python examples/paper", description=head)
    parser.add_argument("-o", "--output", type=Path, default=Path("figures"), help="folder")
    parser.add_argument("--only", action="append", metavar="NAME", help="this figure; repeatable")
    parser.add_argument("--quick", action="store_true", help="fewer photons and seas: minutes")
    parser.add_argument("--list", action="store_true", help="list the names of the figures")
    parser.add_argument("--seed", type=int, default=1, help="seed of the random numbers")
    parser.add_argument("--threads", type=int, help="number of threads; default: all cores")
    parser.add_argument(
        "--profiles", type=Path, action="append", default=[], metavar="A.NC",
        help="temperature and salinity (AODN, Argo); repeatable",
    )  # fmt: skip
    given = parser.parse_args(arguments)
    if given.list:
        print("\n".join(FIGURES))
        return
    setting = Setting(given.seed, given.threads, tuple(given.profiles))
    try:
        made = make_figures(
            given.output, given.only, quick=given.quick, setting=setting, on_figure=_report
        )
    except (Refused, ImportError, OSError) as error:
        parser.exit(2, f"error: {error}\n")
    kept = sum(record["kept"] for record in made)
    print(f"{len(made) - kept} drawn, {kept} kept; read {given.output / INDEX}")


def _report(name: str, record: dict[str, Any] | None) -> None:
    """Report the progress on stderr."""
    state = " ..."
    if record is not None:
        state = ": kept" if record["kept"] else f": {record['wall_s']:.1f} s"
    print(name + state, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
