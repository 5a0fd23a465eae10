# Targets for a newcomer: reproduce, test. The rest: setup, tools, figures, report, docs, test-browser, check, bench, peers,
# urdfs, commanded, measured, plan, fleet, kill-trials, clean, and for maintainers: lock, schema.
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: help setup tools reproduce figures report docs test test-all test-browser test-slurm test-pythons test-digits \
  check bench peers urdfs commanded \
  measured plan fleet kill-trials clean lock schema

PYTHON ?= python3
CORES ?= 2
BIN := .venv/bin
SNAKEMAKE := $(BIN)/snakemake --cores $(CORES) --workflow-profile workflow/profiles/default
PIP := $(BIN)/python -m pip --quiet --disable-pip-version-check --no-input install

help:
	@echo "make reproduce   set up .venv, run the whole workflow, write results/ and results/report.html"
	@echo "make test        set up .venv, run the tests, but for those marked slow"
	@echo "make test-all    all tests: half an hour"
	@echo "make test-pythons   installs and tests it under every supported Python here (PYTHONS=--newest, --quick)"
	@echo "make test-digits   tests of equal digits with other kernels, languages and time zones"
	@echo "make test-browser   the tests that need Chromium on the machine: reports as a browser shows them"
	@echo "make figures     figures and tables, and what they stand on where it is not up to date"
	@echo "make report      results/report.html alone: every campaign's page, pictures of studies"
	@echo "make docs        the documentation site in build/site; a warning is an error"
	@echo "make check       lint, format, types, workflow lint"
	@echo "make bench       measure, and write benchmarks/results.md"
	@echo "make peers       other packages on the same data: benchmarks/peers.md (PA10CAL_IPA_DATA=folder: real too)"
	@echo "make urdfs       real URDFs imported, exported, loaded back: benchmarks/urdfs.md (235 MB, once)"
	@echo "make commanded   simulated robots sent through their models: benchmarks/commanded.md"
	@echo "make measured    the real robots in data/measured, and their table in docs/measured.md"
	@echo "make plan        planned poses against the paper's grid, simulated: benchmarks/plan.md"
	@echo "make fleet       time and memory of many campaigns: benchmarks/fleet.md"
	@echo "make kill-trials   50 runs killed at random moments and called once more: nothing lost (half an hour)"
	@echo "make clean       remove results/ (make setup builds .venv; make tools, make lock, make schema: maintainers)"

setup: .venv/.complete

tools: .venv/.tools

.venv/.locked: users.lock
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || { \
	  echo "make setup: $(PYTHON) is missing or older than Python 3.11;" \
	    "name a newer one: make $(MAKECMDGOALS) PYTHON=python3.11" >&2; exit 1; }
	@echo "Setting up .venv from users.lock (a minute, once) ..."
	@$(PYTHON) -m venv --clear .venv
	@$(PIP) --require-hashes --requirement users.lock
	@touch $@

# Compiled once: where Python is told to write no bytecode, each of some thirty jobs would do it again.
.venv/.complete: .venv/.locked pyproject.toml
	@$(PIP) --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m compileall -q src
	@touch $@

# The same versions, and what tests, checks, documentation and benchmarks need besides.
.venv/.tools: .venv/.complete requirements.lock
	@echo "Adding the tools of requirements.lock to .venv ..."
	@$(PIP) --require-hashes --requirement requirements.lock
	@touch $@

reproduce: setup
	@$(BIN)/pa10cal reproduce --cores $(CORES)

figures: setup
	@$(BIN)/pa10cal reproduce --figures --cores $(CORES)

report: setup
	@$(BIN)/pa10cal report results --out results/report.html

# Files are shared out in the order of tests/conftest.py, not by how many tests they have. Byte code is kept whatever the
# environment says: else all tests and each process that they start are compiled anew.
PYTEST := PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n $(CORES) --dist loadfile --no-loadscope-reorder --ignore tests/browser

test: tools
	$(PYTEST) -m "not slow"

# Those marked slow too: half an hour on two cores.
test-all: tools
	$(PYTEST)
	$(MAKE) test-digits

# With kernels of older processors, in German and Turkish, where the time is off by half an hour.
test-digits: tools
	$(BIN)/python -m benchmarks.digits --cores $(CORES)

# A quarter of an hour a Python, in environments that are removed again.
test-pythons: tools
	$(BIN)/python -m benchmarks.pythons --cores $(CORES) $(PYTHONS)

# Needs Chromium; make test does not.
test-browser: tools
	$(BIN)/pytest tests/browser

# With the Slurm that `.ci/slurm start` brings up: workers and controller are killed.
test-slurm: tools
	PA10CAL_BREAK_SLURM=1 $(BIN)/pytest tests/running/test_slurm.py

docs: tools
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going --fresh-env \
	  --doctree-dir build/doctrees docs build/site
	@echo "build/site/index.html"

check: tools
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/snakefmt --check Snakefile workflow
	$(BIN)/snakemake --lint

bench: tools
	$(BIN)/python -m benchmarks

# Each peer in an environment of its own under build/peers; a quarter of an hour.
peers: tools
	$(BIN)/python -m benchmarks.peers

urdfs: tools
	$(BIN)/python -m benchmarks.urdfs

commanded: tools
	$(BIN)/python -m benchmarks.commanded

measured: setup
	$(SNAKEMAKE) measured
	$(BIN)/python -m pa10cal.datasets.measured

plan: tools
	$(BIN)/python -m benchmarks.plan

# Ten minutes.
fleet: tools
	$(BIN)/python -m benchmarks.fleet

kill-trials: tools
	$(BIN)/python -m benchmarks.kills

clean:
	rm -rf results

# Universal: one lock for every platform and Python version. Pins and hashes only, no address. Users' lock is a part of
# the other.
lock: LOCKED := uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
  --no-emit-index-url --no-emit-find-links
lock:
	@command -v uv >/dev/null || { echo "make lock: uv is needed (a maintainer's tool)" >&2; exit 1; }
	$(LOCKED) --all-extras --output-file requirements.lock pyproject.toml
	$(LOCKED) --extra urdf --extra slurm --extra workbooks --extra arms --extra build --constraint requirements.lock \
	  --output-file users.lock pyproject.toml

schema: tools
	$(BIN)/python docs/_site/config_file.py
	$(BIN)/python docs/_site/record_tables.py
	$(BIN)/python docs/_site/python_page.py docs/python.md
