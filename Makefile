# Short names of the commands that contributors use most; .ci/run is all checks in fresh environments.
.PHONY: environment test lint docs bench figures dist check
python := .venv/bin/python

environment:
	python3 -m venv .venv
	$(python) -m pip install -e ".[test,lint,docs]" pre-commit

test:
	$(python) -m pytest -n auto --dist loadfile

lint:
	.ci/lint

docs:
	.ci/docs --quick

bench:
	.venv/bin/python tests/benchmarks/bench.py

figures:
	$(python) docs/scripts/redraw.py

dist:
	.ci/dist

check:
	.ci/run
