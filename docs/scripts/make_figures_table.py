"""Write the numbers of docs/extra/figures that the paper prints, too, into figures_table.md.

The figures are drawn by `python examples/paper -o docs/extra/figures`.
"""

from __future__ import annotations

import html
import json
import sys

from places import DOCS, GENERATED, ROOT

sys.path.insert(0, str(ROOT / "examples"))

from paper import FIGURES
from paper.runner import number_text

FOLDER = DOCS / "extra" / "figures"
TABLE = GENERATED / "figures_table.md"
NOT_SHOWN = ("RMSE", "MAE", "KS", "KL", "Kolmogorov")


def table() -> str:
    """Return what the figures cost, and a row for every number that the paper prints."""
    records = {
        name: json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8")) for name in FIGURES
    }
    wall, cpu = (sum(r[key] for r in records.values()) / 60.0 for key in ("wall_s", "cpu_s"))
    rows = [
        f"The whole page took {wall:.0f} minutes, and {cpu:.0f} minutes of CPU.",
        "",
        "| figure | quantity | printed | default | paper preset |",
        "|---|---|---|---|---|",
    ]
    for name, record in records.items():
        for row in record["rows"]:
            # parameters, which agree, and measures of fits are on the page of the figures
            if row["printed"] is None or row["quantity"].startswith(NOT_SHOWN) or name == "link":
                continue
            found = (html.unescape(number_text(row[form])) for form in ("default", "paper"))
            cells = (
                record["number"],
                row["quantity"] + f" [{row['unit']}]" * (row["unit"] != "1"),
                f"{row['printed']:.4g}",
                *(text.replace(" ± ", "±") for text in found),
            )
            rows.append("| " + " | ".join(cells) + " |")
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    TABLE.write_text(table(), encoding="utf-8")
