"""Measure the speed of the engine and write the report into performance_table.md.

Run it on a quiet machine: `python docs/scripts/make_performance_table.py`.
"""

from __future__ import annotations

import sys

from places import GENERATED, ROOT

from meshtrace.scenario import Scenario

sys.path.append(str(ROOT / "tests" / "benchmarks"))  # the program is in no package
from bench import bench, report

PAGE = GENERATED / "performance_table.md"


def main() -> None:
    """Write the table."""
    result = bench(Scenario.from_config({"wind_speed": 13.0, "bubbles": "none"}), cold=True)
    e = result["environment"]
    machine = (
        f"on {result['cores']} cores of {e['machine']}, "
        f"Python {e['python']}, numba {e['numba']}, embreex {e['embreex']}"
    )
    PAGE.write_text(f"```text\n{report(result)}\n{machine}\n```\n", encoding="utf-8")


if __name__ == "__main__":
    main()
