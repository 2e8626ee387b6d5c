"""The page of figures in the documentation is whole, in the full setting, and as its records say."""

import json
import shutil
import sys
from pathlib import Path

import pytest

from paper import FIGURES
from paper.registry import load
from paper.runner import write_index

DOCS = Path(__file__).parents[2] / "docs"
FOLDER = DOCS / "extra" / "figures"


@pytest.mark.parametrize("name", FIGURES)
def test_figure_is_there_in_the_full_setting(name):
    record = json.loads((FOLDER / f"{name}.json").read_text())
    assert not record["quick"]
    assert record["effort"] == load(name).effort(quick=False)
    assert record["rows"]
    for kind in (".png", ".csv", ".nc"):
        assert (FOLDER / (name + kind)).stat().st_size > 0


def test_page_is_that_of_the_records(tmp_path):
    for path in FOLDER.glob("*.json"):
        shutil.copy(path, tmp_path)
    write_index(tmp_path)
    assert (tmp_path / "index.html").read_text() == (FOLDER / "index.html").read_text()


def test_table_is_that_of_the_records(monkeypatch):
    monkeypatch.syspath_prepend(DOCS / "scripts")
    import make_figures_table

    assert make_figures_table.TABLE.read_text() == make_figures_table.table()
    sys.modules.pop("make_figures_table")
