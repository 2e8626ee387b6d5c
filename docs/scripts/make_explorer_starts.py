"""Compute time, margin and verdict of the links that the explorer offers at its start.

python docs/scripts/make_explorer_starts.py
"""

from __future__ import annotations

import re

from places import ROOT

from meshtrace.apps.explorer import readings
from meshtrace.apps.explorer.controls import STARTS
from meshtrace.scenario import Scenario


def main() -> None:
    file = ROOT / "meshtrace" / "apps" / "explorer" / "assets" / "starts.toml"
    text = re.sub("^(time|margin|verdict) = .*\n", "", file.read_text("utf-8"), flags=re.MULTILINE)
    for name, start in STARTS.items():
        answer = readings.answer_of_start(Scenario.from_config(start["link"]))
        lines = f"time = {answer['time']}\nmargin = {answer['margin']}\n"
        lines += f'verdict = "{answer["verdict"]}"\n'
        head = re.search(f"^\\[{name}\\]\n", text, re.MULTILINE)
        assert head
        text = text[: head.end()] + lines + text[head.end() :]
    file.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
