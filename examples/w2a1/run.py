"""Run the reference case W2A-1 by meshtrace, write results.csv and print the score."""

import csv
import subprocess
import sys
from pathlib import Path

from meshtrace.apps import w2a1


def numbers(result):
    """Return the numbers of a row: unscattered and total gain, and the error of the total."""
    return float(result.gain_ballistic), float(result.gain), float(result.gain_stderr)


def rows():
    """Yield the rows of the results."""
    case = w2a1.reference()
    for name in case["cases"]:
        yield (name, "", *numbers(w2a1.gain(name)))
    for name, table in case["series_frozen_phases"].items():
        for i, gain in enumerate(w2a1.series(name.split("/")[0])):
            yield (name, table["t0"] + i * table["dt"], *numbers(gain))


def main():
    """Write the results and score them."""
    with open("results.csv", "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(("case", "time", "unscattered", "total", "total_stderr"))
        writer.writerows(rows())
    score = Path(__file__).with_name("score.py")
    subprocess.run([sys.executable, str(score), "results.csv"], check=True)


if __name__ == "__main__":
    main()
