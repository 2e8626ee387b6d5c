"""Score the results of any program for the reference case W2A-1.

python score.py results.csv needs nothing but Python. Columns of the file, with a heading:

    case,time,unscattered,total,total_stderr

`case` is a key of "cases" in w2a1.json with an empty time, or "jonswap5/series" and
"jonswap13/series" with the time in s. Empty cells are not scored. Monte Carlo programs may add
`unscattered_stderr`: unscattered gains are then scored as totals are.
"""

import csv
import json
import math
import sys
from pathlib import Path

CASE = json.loads(Path(__file__).with_name("w2a1.json").read_text(encoding="utf-8"))


def number(row, key):
    """Return a cell as a number, nan if it is empty."""
    try:
        return float(row.get(key) or "nan")
    except ValueError:
        raise SystemExit(f"{key}: {row[key]!r}, allowed: a number or an empty cell") from None


def scored(row):
    """Yield (what, passed, remark) for the numbers of one case."""
    name, expected = row["case"], CASE["cases"][row["case"]]
    got, error = number(row, "unscattered"), number(row, "unscattered_stderr")
    if not math.isnan(error):
        yield f"{name} unscattered", *by_error(got, error, expected["unscattered"], 0.0)
    elif not math.isnan(got):
        off, tolerance = got / expected["unscattered"] - 1.0, expected["unscattered_tol_rel"]
        yield f"{name} unscattered", abs(off) <= tolerance, f"{off:+.1e} of {tolerance:g}"
    got, error = number(row, "total"), number(row, "total_stderr")
    if not math.isnan(got):
        yield f"{name} total", *by_error(got, error, expected["total"], expected["total_stderr"])


def by_error(got, error, expected, expected_error):
    """Return (passed, remark) of a number with a standard error."""
    both = math.hypot(error, expected_error)
    z = (got - expected) / both if both > 0.0 else math.nan
    precise = 0.0 <= error <= 0.005 * expected
    return abs(z) <= 3.0 and precise, f"z = {z:+.2f}" + ("" if precise else ", error beyond 0.5 %")


def scored_series(name, rows):
    """Yield (what, passed, remark) for one series."""
    expected = CASE["series_frozen_phases"][name]
    n, offs, totals = expected["n"], {}, []
    for row in rows:
        step = (number(row, "time") - expected["t0"]) / expected["dt"]
        if not any(abs(step - k) < 1e-3 for k in range(n)):
            allowed = f"{expected['t0']:g} + k {expected['dt']:g} s for k from 0 to {n - 1}"
            raise SystemExit(f"time: {row['time']!r}, allowed: {allowed}")
        k = round(step)
        offs[k] = number(row, "unscattered") / expected["unscattered_gain"][k] - 1.0
        totals.append(number(row, "total"))
    whole = len(offs) == len(rows) == n
    if not all(map(math.isnan, offs.values())):
        passed = whole and all(abs(off) <= 5e-3 for off in offs.values())
        worst = max((off for off in offs.values() if not math.isnan(off)), key=abs)
        yield f"{name} unscattered", passed, f"worst {worst:+.1e} of 0.005"
    if not all(map(math.isnan, totals)):
        mean = sum(totals) / len(totals)
        spread = math.sqrt(sum((t - mean) ** 2 for t in totals) / max(len(totals) - 1, 1)) / mean
        off = spread / expected["total_rel_std"] - 1.0
        yield f"{name} spread of total", whole and abs(off) <= 0.01, f"{off:+.1e} of 0.01"


def score(rows):
    """Return (what, passed, remark) of all rows of a file of results."""
    found, series, seen = [], {}, set()
    for row in rows:
        if row.get("case") in CASE["cases"]:
            if row["case"] in seen:
                raise SystemExit(f"case: {row['case']!r}, allowed: once")
            seen.add(row["case"])
            found += scored(row)
        elif row.get("case") in CASE["series_frozen_phases"]:
            series.setdefault(row["case"], []).append(row)
        else:
            raise SystemExit(f"case: {row.get('case')!r}, allowed: a case or series of w2a1.json")
    for name, times in series.items():
        found += scored_series(name, times)
    return found


def main():
    """Print the score of a file."""
    if len(sys.argv) != 2:
        raise SystemExit(__doc__ or "usage: score.py RESULTS.CSV")
    try:
        with open(sys.argv[1], newline="", encoding="utf-8") as file:
            found = score(csv.DictReader(file))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise SystemExit(f"{sys.argv[1]}: {error}, allowed: a CSV file") from None
    for what, passed, remark in found:
        print(f"{'pass' if passed else 'FAIL'}  {what:32s} {remark}")
    print(f"score {sum(passed for _, passed, _ in found)} of {len(found)}")


if __name__ == "__main__":
    main()
