# `make demo` and `make test` set up what they need in .venv and then run; Python 3.11 or newer and make are enough.

# small matrix products run best on one thread each; set these yourself for large ones
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
# what is compiled once is kept: to rewrite the tests anew takes each worker as long as a hundred of them
unexport PYTHONDONTWRITEBYTECODE

PYTHON ?= $(shell for p in python3 python3.14 python3.13 python3.12 python3.11 python; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := .venv/bin
# one process per core, up to eight; `make test WORKERS=0` runs in one process
WORKERS ?= auto
PYTEST := $(BIN)/python -m pytest --numprocesses=$(WORKERS) --maxprocesses=8 --dist=worksteal
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check

.PHONY: demo test thorough lint docs dist notebooks links clean

demo: .venv/core
	$(BIN)/certigym run reach-avoid-v0

# each map, backup, law, rule of the format and forgery once, on small problems; a part: `make test ARGS=tests/envs`
test: .venv/test lint
	$(PYTEST) -m "not thorough and not pages" $(ARGS)

# what searches as long as users do, or repeats a question for more problems, laws and seeds; and types
thorough: .venv/test
	@$(BIN)/python -m mypy > .venv/types.txt & types=$$!; $(PYTEST) -m "thorough and not pages" $(ARGS); tests=$$?; \
		wait $$types; typed=$$?; cat .venv/types.txt; exit $$((tests + typed))

lint: .venv/test
	$(BIN)/python -m ruff check .
	$(BIN)/python -m ruff format --check .
	$(BIN)/python -m ruff format --check --line-length 80 README.md CONTRIBUTING.md docs/*.md docs/*/*.md

# warnings are errors, and what pages and examples show is run; needs no network once the packages are installed
docs: .venv/docs .venv/test
	$(PYTEST) -m pages
	$(BIN)/python -m sphinx -W --keep-going -n -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

# builds the archives and checks them as an index would
dist: .venv/publish
	rm -rf dist && $(BIN)/python -m build --outdir dist .
	$(BIN)/twine check --strict dist/* && $(BIN)/check-wheel-contents dist/*.whl

# runs the notebooks of examples/ and does not save them
notebooks: .venv/notebooks
	for book in examples/notebook_*.ipynb; do echo "$$book" && $(BIN)/jupyter-execute --timeout=300 "$$book" || exit 1; done

# follows external links: needs a network
links: .venv/docs
	$(BIN)/python -m sphinx -q -b linkcheck docs docs/_build/links

clean:
	rm -rf .venv build dist docs/_build

.venv/python:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is needed; name one: make PYTHON=/path/to/python" >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv .venv
	@touch $@

.venv/core: pyproject.toml .venv/python
	$(PIP) --editable .
	@touch $@

.venv/test: pyproject.toml constraints.txt .venv/python
	$(PIP) --constraint constraints.txt --editable '.[test,rl]' || \
		{ echo "no torch for this Python: the tests of learners will be skipped" >&2; \
		$(PIP) --constraint constraints.txt --editable '.[test]'; }
	@touch $@ .venv/core

.venv/publish: pyproject.toml constraints.txt .venv/python
	$(PIP) --constraint constraints.txt --editable '.[publish]'
	@touch $@ .venv/core

.venv/notebooks: pyproject.toml constraints.txt .venv/test
	$(PIP) --constraint constraints.txt --editable '.[notebooks,viz]'
	@touch $@

.venv/docs: pyproject.toml constraints.txt .venv/python
	$(PIP) --constraint constraints.txt --editable '.[docs]'
	@touch $@ .venv/core
