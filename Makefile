# Targets for a newcomer: reproduce, test. The rest: setup, figures, report, docs, test-browser, check, bench, peers,
# urdfs, commanded, plan, fleet, kill-trials, clean, and for maintainers: lock, schema.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup reproduce figures report docs test test-browser test-slurm check bench peers urdfs commanded plan fleet \
  kill-trials clean lock schema

PYTHON ?= python3
CORES ?= 2
BIN := .venv/bin
SNAKEMAKE := $(BIN)/snakemake --cores $(CORES) --workflow-profile workflow/profiles/default
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check --no-input install

help:
	@echo "make reproduce   set up .venv, run the whole workflow, write results/ and results/report.html"
	@echo "make test        set up .venv, run the tests"
	@echo "make test-browser   the tests that need Chromium on the machine: reports as a browser shows them"
	@echo "make figures     figures and tables, and what they stand on where it is not up to date"
	@echo "make report      results/report.html alone"
	@echo "make docs        the documentation site in build/site; a warning is an error"
	@echo "make check       lint, format, types, workflow lint"
	@echo "make bench       measure, and write benchmarks/results.md"
	@echo "make peers       other packages on the same data: benchmarks/peers.md (PA10CAL_IPA_DATA=folder: real too)"
	@echo "make urdfs       real URDFs imported, exported, loaded back: benchmarks/urdfs.md (235 MB, once)"
	@echo "make commanded   simulated robots sent through their models: benchmarks/commanded.md"
	@echo "make plan        planned poses against the paper's grid, simulated: benchmarks/plan.md"
	@echo "make fleet       time and memory of many campaigns: benchmarks/fleet.md"
	@echo "make kill-trials   50 runs killed at random moments and called once more: nothing lost (half an hour)"
	@echo "make clean       remove results/ (make setup builds .venv; make lock, make schema: maintainers)"

setup: .venv/.complete

.venv/.locked: requirements.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "make setup: $(PYTHON) is missing or older than Python 3.11;" \
	    "name a newer one: make $(MAKECMDGOALS) PYTHON=python3.11" >&2; exit 1; }
	@echo "Setting up .venv from requirements.lock (a minute, once) ..."
	@$(PYTHON) -m venv --clear .venv
	@$(PIP) --require-hashes --requirement requirements.lock
	@touch $@

.venv/.complete: .venv/.locked pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable .
	@touch $@

reproduce: setup
	@$(BIN)/pa10cal reproduce --cores $(CORES)

figures: setup
	@$(BIN)/pa10cal reproduce --figures --cores $(CORES)

report: setup
	$(SNAKEMAKE) --report results/report.html

test: setup
	$(BIN)/pytest -n $(CORES) --dist loadfile --ignore tests/browser

# Needs Chromium; make test does not.
test-browser: setup
	$(BIN)/pytest tests/browser

# With the Slurm that `.ci/slurm start` brings up: workers and controller are killed.
test-slurm: setup
	PA10CAL_BREAK_SLURM=1 $(BIN)/pytest tests/running/test_slurm.py

docs: setup
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --fresh-env \
	  --doctree-dir build/doctrees docs build/site
	@echo "build/site/index.html"

check: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint

bench: setup
	$(BIN)/python -m benchmarks

# Each peer in an environment of its own under build/peers; a quarter of an hour.
peers: setup
	$(BIN)/python -m benchmarks.peers

urdfs: setup
	$(BIN)/python -m benchmarks.urdfs

commanded: setup
	$(BIN)/python -m benchmarks.commanded

plan: setup
	$(BIN)/python -m benchmarks.plan

# Half an hour.
fleet: setup
	$(BIN)/python -m benchmarks.fleet

kill-trials: setup
	$(BIN)/python -m benchmarks.kills

clean:
	rm -rf results

# Universal: one lock for every platform and Python version. Pins and hashes only, no address.
lock:
	@command -v uv >/dev/null || { echo "make lock: uv is needed (a maintainer's tool)" >&2; exit 1; }
	uv pip compile --quiet --universal --python-version 3.11 --all-extras --generate-hashes \
	  --no-header --no-emit-index-url --no-emit-find-links --output-file requirements.lock pyproject.toml

schema: setup
	$(BIN)/python -m pa10cal.planning.schema
	$(BIN)/python -m pa10cal.results.docs
	$(BIN)/python -m pa10cal.planning.reference docs/python.md
