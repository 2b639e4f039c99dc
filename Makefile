# `make run`: the paper's experiment.  `make test`: everything a change must pass.  `make help`: the rest.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
JOBS   ?= $(shell echo $$(( $$(nproc) + 2 )))  # some tests wait
CELL   ?= configs/cells/paper.toml

.DEFAULT_GOAL := help
.PHONY: help run test test-fresh long fuzz mutate soak kills engine faults false-trips hil campaign failing varied phases by-hand bench format clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## */\1\t/' | expand -t 12

# What the host must have is looked for before pip starts; each lack is one line with its remedy.  An environment that is
# there keeps its Python: another one laid over it would mix its library with the old program.
$(VENV)/.installed: pyproject.toml
	@command -v $(PYTHON) >/dev/null || { echo 'coop: no $(PYTHON) here: apt install python3 python3-venv' >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "coop: Python is %d.%d, needed 3.11 or newer (Debian 12 has it): make %s PYTHON=python3.11" % (sys.version_info[0], sys.version_info[1], "$(MAKECMDGOALS)"))'
	@$(PYTHON) -c 'import sys; sys.exit(sys.maxsize < 2**32 and "coop: Python has 32 bits, pinocchio needs 64: install a 64-bit system")'
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || { echo 'coop: $(PYTHON) cannot make an environment: apt install python3-venv' >&2; exit 1; }
	@$(BIN)/python -m pip --version >/dev/null 2>&1 || $(PYTHON) -m venv $$(test ! -f $(VENV)/pyvenv.cfg || echo --clear) $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@

run: $(VENV)/.installed  ## the paper's experiment in simulation, 100 s, report in runs/
	$(BIN)/coop run $(CELL)

# Types and contracts are looked at on what the tests leave of the cores, and told of behind them.  The tests start
# some hundred processes: what Python compiles is kept, even where the environment says otherwise, and in a fresh tree it
# is compiled once before the workers, each of which would do it for itself.
test: export PYTHONDONTWRITEBYTECODE =
test: $(VENV)/.installed  ## format, lint, types, import contracts, tests
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	@said=$$(mktemp); { $(BIN)/mypy && $(BIN)/lint-imports; } >$$said 2>&1 & checks=$$!; \
	trap 'kill $$checks 2>/dev/null; rm -f $$said' EXIT; trap 'exit 130' INT TERM; \
	test -d tests/unit/__pycache__ || $(BIN)/pytest --collect-only -qq -p no:xdist >/dev/null 2>&1; \
	$(BIN)/pytest -m "not realtime and not long" -n $(JOBS) --dist worksteal; tests=$$?; \
	wait $$checks; checked=$$?; cat $$said; exit $$((tests | checked))
	$(BIN)/pytest -m "realtime and not long" tests/process

test-fresh: $(VENV)/.installed  ## `make run` on minimal Debian 12 and 13, each in a tree of its own; root, 2 min each
	$(BIN)/pytest --fresh tests/process/install/test_fresh_machine.py

long: $(VENV)/.installed  ## simulations and repetitions of which `make test` runs some (7 min, and 12 of one core for lost packets)
	$(BIN)/pytest -m "long and not realtime" -n $(JOBS) --dist worksteal
	$(BIN)/pytest -m "long and realtime" tests/process
	HYPOTHESIS_PROFILE=whole $(BIN)/pytest -m hypothesis -n $(JOBS) --dist worksteal tests/property tests/unit

mutate: $(VENV)/.installed  ## one-line changes that a test must notice; MUTATE_ONLY=TEXT for some modules, MUTATE_DONE=FILE goes on where it stopped
	$(BIN)/python -m tests.mutate

fuzz: $(VENV)/.installed  ## thousands of changed files through what reads them (half an hour)
	HYPOTHESIS_PROFILE=long $(BIN)/pytest -m fuzz

soak: $(VENV)/.installed  ## every cell for 1000 s (SOAK_S), recorder under load, memory and gaps stay flat; SOAK_ONLY=TEXT for some
	$(BIN)/python -m tests.soak

kills: $(VENV)/.installed  ## a recorder killed at random, KILLS times (20): what is lost, and four readers of what is left (3 min)
	$(BIN)/python -m tests.campaign.kills

campaign: $(VENV)/.installed  ## random gains, pads, delays: what the criterion accepts must live; arms that learn and disagree (15 min); CAMPAIGN_N, CAMPAIGN_SEED
	$(BIN)/python -m tests.campaign

failing: $(VENV)/.installed  ## an arm of a random cell goes limp, holds or locks: what check says of the object comes true (10 min); FAILING_N, FAILING_SEED
	$(BIN)/python -m tests.campaign.failing

varied: $(VENV)/.installed  ## cells as users might write or make them: nothing holds while nothing fails (30 min); VARIED_N, VARIED_MADE, VARIED_SEED
	$(BIN)/python -m tests.campaign.varied

engine: $(VENV)/.installed  ## the shipped cells in MuJoCo beside our plant, and how far the two are apart (20 min); installs MuJoCo; ENGINE_S, ENGINE_SEEDS, ENGINE_ONLY
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[engine]'
	$(BIN)/python -m tests.campaign.engine

phases: $(VENV)/.installed  ## every phase of a session met by a stop, dead agents, lost power, a lost port, in virtual time (5 min); PHASES=stop,...
	$(BIN)/python -m tests.campaign.phases $(PHASES)

by-hand: $(VENV)/.installed  ## float, calibrate, run by real processes on emulated servos that are off: disagreement, internal force (6 min); BY_HAND=N realities
	$(BIN)/python -m tests.campaign.by_hand

faults: $(VENV)/.installed  ## the whole list of faults, what each costs, false trips; FAULTS_OUT=FILE as JSON, FAULTS_S seconds
	FAULTS_OUT=$(FAULTS_OUT) $(BIN)/python -m tests.faults

false-trips: $(VENV)/.installed  ## how often nothing trips: FAULTS_S simulated seconds of drawn realities; FAULTS_TRIPS=FILE goes on where it stopped
	FAULTS_TRIPS=$(FAULTS_TRIPS) $(BIN)/python -m tests.faults.false_trips

hil: $(VENV)/.installed  ## rehearsals against simulated cells: every cell, arms that are otherwise, faults, in virtual time (8 min)
	$(BIN)/python -m tests.support.hil

bench: $(VENV)/.installed  ## speed and memory; BENCH_OUT=FILE writes the figures as JSON
	$(BIN)/python -m tests.bench $(if $(BENCH_OUT),--out $(BENCH_OUT))

format: $(VENV)/.installed  ## rewrite the sources in the house format
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

clean:  ## remove the environment and caches (keeps runs/)
	rm -rf $(VENV) build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
