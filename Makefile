# `make run`: the paper's experiment.  `make test`: everything a change must pass.  `make help`: the rest.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
CELL   ?= configs/cells/paper.toml

.DEFAULT_GOAL := help
.PHONY: help run test bench format clean

help:  ## this list
	@grep -hE '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## */\1\t/' | expand -t 10

$(VENV)/.installed: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed, found " + sys.version)'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

run: $(VENV)/.installed  ## the paper's experiment in simulation, 100 s, report in runs/
	$(BIN)/coop run $(CELL)

test: $(VENV)/.installed  ## format, lint, types, import contracts, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/pytest

bench: $(VENV)/.installed  ## speed and memory; BENCH_OUT=FILE writes the figures as JSON
	$(BIN)/python -m tests.bench $(if $(BENCH_OUT),--out $(BENCH_OUT))

format: $(VENV)/.installed  ## rewrite the sources in the house format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:  ## remove the environment and caches (keeps runs/)
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
