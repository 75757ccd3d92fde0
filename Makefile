# Everything a newcomer needs. Only python3 (3.11 or newer, with venv and pip) and make have to be on the machine.

SHELL := /bin/bash
.SHELLFLAGS := -euo pipefail -c
.DEFAULT_GOAL := help
.DELETE_ON_ERROR:

PYTHON ?= python3
BIN := .venv/bin

# For `make pins`: what may change.
UPGRADE ?= --upgrade

# Processors that run tests. As many tests wait, for others or for real time, twice as many processes run them.
WORKERS ?= 2
PROCESSES = $$(( 2 * $(WORKERS) ))

# Runs the targets that follow at the same time, and prints the output of each in one piece.
TOGETHER := $(MAKE) --no-print-directory --jobs $(if $(filter output-sync,$(.FEATURES)),--output-sync=target)

# Python files that differ from where this branch left main, those that git does not know yet included.
BASE := git merge-base HEAD main 2>/dev/null || git rev-parse HEAD
CHANGED := { git diff --name-only --diff-filter=d "$$($(BASE))"; git ls-files --others --exclude-standard; } \
	| grep -E '^(packages|tests|examples|benchmarks)/.*\.py$$' | sort -u || true

# The environment is built once for each content of these files: touching or checking them out again costs nothing.
PARTS := $(patsubst %/pyproject.toml,%,$(wildcard packages/*/pyproject.toml))
PINS := pyproject.toml requirements.txt $(PARTS:%=%/pyproject.toml)
SUM := $(shell cat $(PINS) | cksum | cut -d ' ' -f 1)

# What is in it: `test` at once, each other set when a target first needs it. Sections of requirements.txt name their sets.
STAMP := .venv/.test-$(SUM)
CHECK := .venv/.check-$(SUM)
DOCS := .venv/.docs-$(SUM)
KITS := .venv/.kits-$(SUM)
E2E := .venv/.e2e-$(SUM)
BYTES := .venv/.bytes-$(SUM)

# Tests, by suite: those of one part are in its folder, those of several in tests/.
UNIT := $(wildcard packages/*/tests/unit)
ALL_TESTS := $(wildcard packages/*/tests/unit packages/*/tests/property packages/*/tests/integration) tests/unit tests/property tests/integration
# Tests that are skipped where a kit is not installed.
KITTED = $(shell grep -rl importorskip packages/*/tests tests --include='test_*.py' | grep -v /e2e/)
COVERED := $(wildcard packages/*/tests/unit/protocol packages/llm-flock/tests/unit/test_algorithm1.py packages/llm-flock/tests/unit/test_geometry_planner.py)

define section
awk -v set="$(1)" '/^[#] / { on = 0; for (i = 2; i <= NF; i++) if ($$i == set) on = 1 } on' requirements.txt
endef

export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PYRIGHT_PYTHON_IGNORE_WARNINGS := 1
# Tests start many processes: byte code is kept even where the shell says otherwise.
unexport PYTHONDONTWRITEBYTECODE

# Pythons that may be here beside that of .venv, the newest first.
VERSIONS := 3.14 3.13 3.12 3.11
OTHERS := $(foreach version,$(VERSIONS),python$(version) $(wildcard $(HOME)/.pyenv/versions/$(version).*/bin/python))

.PHONY: help setup everything demo quick unit kits changed test covered others fuzz e2e check lint types layers docs pins lines wheels alone sbom audit show pictures bench mutants clean

help: ## Show this list
	@sed -nE 's/^([a-z0-9-]+):.*## (.*)/\1|\2/p' $(MAKEFILE_LIST) | awk -F '|' '{ printf "  make %-8s %s\n", $$1, $$2 }'

setup: $(STAMP) ## Build .venv with everything pinned (does nothing when it is up to date)

$(STAMP): | $(PINS)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python 3.11 or newer is needed: make PYTHON=python3.11")'
	@# The environment of another working tree is left alone.
	@if [ -L .venv ]; then rm .venv; fi
	@$(PYTHON) -m venv --clear .venv
	@# Every file that is installed has to have a hash in requirements.txt. uv takes a quarter of pip's time, but does not
	@# read pip's settings: where it finds no packages, pip installs them. What both have to say is in the log.
	@awk '/^uv==/ { on = 1 } on { print } on && !/\\$$/ { exit }' requirements.txt > .venv/uv.txt
	@$(BIN)/python -m pip install --no-deps --require-hashes --requirement .venv/uv.txt > .venv/install.log 2>&1 \
	  || { tail -n 20 .venv/install.log >&2; echo "setup: the installation failed; all of its output is in .venv/install.log" >&2; exit 1; }
	@$(call install,test)
	@$(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation $(PARTS:%=--editable %)
	@echo "setup: done"
	@touch $@

define install
$(call section,$(1)) > .venv/$(1).txt; \
echo "setup: $$(grep -c '==' .venv/$(1).txt) packages for $(1) go to .venv, once"; \
logged() { "$$@" >> .venv/install.log 2>&1; }; \
logged $(BIN)/uv pip install --python $(BIN)/python --no-deps --require-hashes --requirement .venv/$(1).txt \
  || { echo "setup: uv finds no packages, pip takes over; this takes some minutes"; \
       logged $(BIN)/python -m pip install --no-deps --require-hashes --requirement .venv/$(1).txt; } \
  || { tail -n 20 .venv/install.log >&2; echo "setup: the installation failed; all of its output is in .venv/install.log" >&2; exit 1; }
endef

.venv/.%-$(SUM): | $(STAMP)
	@$(call install,$*); touch $@

everything: $(STAMP) $(CHECK) $(DOCS) $(KITS) $(E2E) ## Build .venv with every set, as CI does

demo: $(STAMP) ## Ten robots form a circle; record, figure and animation go to runs/demo
	@rm -rf runs/demo
	$(BIN)/llm-flock run --shape circle --robots 10 --seed 7 --model simulated:slow@0.1 --out runs/demo
	$(BIN)/llm-flock figure runs/demo/run.mcap
	$(BIN)/llm-flock animate runs/demo/run.mcap

quick: $(CHECK) ## Lint, types of changed files, unit tests of changed parts: within 40 s, before each commit
	@$(TOGETHER) lint changed unit

unit: $(STAMP) ## Unit tests of the parts that differ from main, and of all together, without those that are long
	@parts="$$({ $(CHANGED); } | cut -d / -f 1,2)"; \
	$(BIN)/python -m pytest $$(for tests in $(UNIT); do grep -qx "$${tests%/tests/unit}" <<< "$$parts" && echo "$$tests"; done) tests/unit \
	  -m "not no_cover and not slow" --quiet --numprocesses 2 --dist worksteal

changed: $(CHECK) ## Type check of the files that differ from main
	@files="$$($(CHANGED))"; if [ -n "$$files" ]; then $(BIN)/pyright --pythonpath $(BIN)/python $$files; else echo "no Python file has changed"; fi

test: $(STAMP) $(DOCS) ## Unit, property and integration tests, and that every branch of ring 0 and of protocol/ is covered
	@# At the same time, as some tests wait.
	@$(MAKE) --no-print-directory --jobs covered others

covered: $(STAMP)
	$(BIN)/python -m pytest $(COVERED) --quiet --cov

others: $(STAMP) $(DOCS) $(BYTES)
	$(BIN)/python -m pytest $(ALL_TESTS) $(COVERED:%=--ignore %) --numprocesses $$(( 1 + $(WORKERS) )) --dist worksteal

# Byte code of all tests, made once by one process (27 s): processes that begin at the same time would each make it.
$(BYTES): | $(STAMP)
	@$(BIN)/python -m pytest $(ALL_TESTS) $(COVERED:%=--ignore %) --collect-only --quiet > /dev/null || true; touch $@

fuzz: $(STAMP) ## Twenty thousand hostile messages, reports, files, configurations and answers of each kind (minutes)
	LLM_FLOCK_EFFORT=100 $(BIN)/python -m pytest $(wildcard tests/property/test_legal_reports.py tests/property/test_hostile_*.py tests/integration/test_hostile_*.py packages/*/tests/*/test_hostile_*.py) --numprocesses 2 --dist worksteal --show-capture no --durations 5 --override-ini faulthandler_timeout=3600

kits: $(E2E) $(KITS) $(DOCS) ## The files of tests that `make test` skips in part where a vendor's kit is not installed
	$(BIN)/python -m pytest $(KITTED) --numprocesses $(WORKERS) --dist worksteal

e2e: $(E2E) $(KITS) ## End-to-end tests through the command line
	$(BIN)/python -m pytest tests/e2e --numprocesses $(PROCESSES) --dist loadscope --no-loadscope-reorder

check: $(CHECK) $(DOCS) $(KITS) ## Lint, types, layers and docs at the same time, as in CI
	@$(TOGETHER) lint types layers docs

lint: $(STAMP) ## Lint and format check
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(CHECK) $(KITS) $(E2E) $(DOCS) ## Type check
	$(BIN)/pyright --pythonpath $(BIN)/python

layers: $(CHECK) ## Who may import whom
	$(BIN)/lint-imports

pins: $(STAMP) ## Regenerate requirements.txt with the newest versions that are allowed (UPGRADE= keeps those there)
	$(BIN)/python -m benchmarks.pins $(UPGRADE)

lines: ## Lines of each part and ring against the budgets
	@$(PYTHON) -m benchmarks.lines

wheels: $(STAMP) ## Build every part to dist/: pip install --find-links dist 'llm-flock[view]'
	rm -rf dist
	for part in $(PARTS); do $(BIN)/uv build --quiet --wheel --no-build-isolation --python $(BIN)/python --out-dir dist $$part; done

# The part whose turn it is, by the number of commits.
TURN ?= $(shell parts=(swarm flight view lab onboard); echo "$${parts[$$(( $$(git rev-list --count HEAD 2>/dev/null || echo 0) % 5 ))]}")

alone: wheels ## The core, then the core with one other part (TURN=view), installed and tested in a clean environment
	@# On the newest Python that is here: the other tests run on that of .venv. Those of protocol/, which needs no other
	@# part and takes half the time, do so only.
	@for python in $(OTHERS) $(PYTHON); do "$$python" -c 'import venv' 2>/dev/null && break; done; \
	folder=build/alone; "$$python" -m venv --clear --without-pip "$$folder"; \
	for part in "" "$(TURN)"; do \
	  name="llm-flock$${part:+-$$part}"; \
	  tests="packages/llm-flock/tests/unit"; if [ -n "$$part" ]; then tests="packages/$$name/tests/unit"; fi; \
	  echo "alone: $$name on $$("$$python" --version)"; \
	  $(BIN)/uv pip install --quiet --python "$$folder/bin/python" --constraint <(sed -E '/--hash/d; s/ \\$$//; /^#/d' requirements.txt) \
	    $(PARTS:packages/%=--refresh-package %) --find-links dist "$$name" pytest pytest-xdist hypothesis; \
	  "$$folder/bin/llm-flock" doctor > /dev/null; \
	  if [ -d "$$tests" ]; then "$$folder/bin/python" -m pytest "$$tests" --ignore-glob '*/protocol' --quiet --numprocesses 2 -m "not slow" -p no:cacheprovider; fi; \
	done

sbom: $(KITS) ## List the parts that `make setup` installs: sbom.cdx.json (CycloneDX)
	$(BIN)/python -m benchmarks.supply sbom sbom.cdx.json

audit: $(KITS) ## Which parts have known faults: make audit DATABASE=FILE, advisories in the OSV format
	$(BIN)/python -m benchmarks.supply audit "$(DATABASE)"

show: $(STAMP) ## Sixty robots fly a word, a heart and a sphere, from one sentence each; the animation goes to runs/show
	$(BIN)/python -m benchmarks.show

pictures: $(E2E) ## Retake the pictures of the viewer's page, in a real browser, of the gallery and of the README
	$(BIN)/python docs/viewer_images.py
	$(BIN)/python docs/gallery_images.py

docs: $(DOCS) ## Build the documentation into build/docs, warnings are errors
	$(BIN)/sphinx-build --fail-on-warning --keep-going --quiet -b html docs build/docs
	@echo "open build/docs/index.html"

bench: $(KITS) ## Measure the framework's overhead
	$(BIN)/python -m benchmarks

mutants: $(STAMP) ## Break each invariant in a copy of the sources: do the tests notice?
	$(BIN)/python -m benchmarks.mutants

clean: ## Remove builds, caches and the environment; runs/ is kept
	rm -rf .venv build dist .coverage .hypothesis .pytest_cache .ruff_cache .import_linter_cache
	find packages tests examples benchmarks docs -name __pycache__ -type d -prune -exec rm -rf {} +
