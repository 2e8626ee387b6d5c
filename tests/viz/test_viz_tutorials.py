"""The tutorials run in a notebook, and every cell that draws shows its pictures."""

import ast
import re
from pathlib import Path

import pytest

TUTORIALS = Path(__file__).parents[2] / "docs" / "tutorials"
PAGES = sorted(path for path in TUTORIALS.glob("*.md") if path.stem != "index")
CELL = re.compile(r"^```\{code-cell\} python\n(?:---\n.*?^---\n)?(.*?)^```$", re.M | re.S)


def figures(code):
    """Return the number of figures that a cell draws: calls of viz.plot..., or pyplot's figure."""
    calls = [ast.unparse(n.func) for n in ast.walk(ast.parse(code)) if isinstance(n, ast.Call)]
    own = sum(name.startswith("viz.plot") for name in calls)
    return own + any(name.startswith("plt.") for name in calls)


@pytest.mark.process
@pytest.mark.thorough
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
@pytest.mark.slow_but("first_link")
def test_every_plot_is_shown(page, tmp_path):
    client, v4 = pytest.importorskip("nbclient"), pytest.importorskip("nbformat.v4")
    pytest.importorskip("ipykernel")
    codes = CELL.findall(page.read_text("utf-8"))
    notebook = v4.new_notebook(cells=[v4.new_code_cell(code) for code in codes])
    client.NotebookClient(notebook, resources={"metadata": {"path": tmp_path}}).execute()
    for code, cell in zip(codes, notebook.cells, strict=True):
        shown = [output for output in cell.outputs if "image/png" in output.get("data", {})]
        assert len(shown) == figures(code), code


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_a_tutorial_is_a_question_with_an_answer(page):
    text = page.read_text("utf-8")
    assert re.search(r"^# \d\. .+\?$", text, re.MULTILINE)
    parts = ("**Goal.**", f"{{nb-download}}`{page.stem}.ipynb`", "**Read from it.**", "## Exercise")
    places = [text.index(part) for part in parts]
    assert places == sorted(places)
    answer = text[places[-1] :]
    assert "tags: [hide-cell]" in answer
    assert any(line.startswith("# ") for line in CELL.findall(answer)[-1].splitlines())


def test_there_are_eight():
    assert len(PAGES) == 8
