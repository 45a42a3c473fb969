# make demo | test | lint | docs: each sets up what it needs on a fresh machine; the second run starts at once.
# The environment is .venv (VENV=… for another); PYTHON=… chooses the interpreter it is made from.
VENV ?= .venv
OUT ?= demo
PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo $$p && break; done)
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
CORE := $(VENV)/.core-installed
WORLDS := $(VENV)/.worlds-installed
DEV := $(VENV)/.dev-installed

.PHONY: demo test lint docs coverage fuzz hostile relayed lock resolve clean
demo: $(WORLDS)
	$(BIN)/maslam demo --out $(OUT)

# Two processes on two cores: more threads of linear algebra only wait for each other.
test: export OMP_NUM_THREADS ?= 1
test: export OPENBLAS_NUM_THREADS ?= 1
test: lint
	$(BIN)/python -m pytest -n 2 --dist worksteal

lint: $(DEV)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/lint-imports --no-logo
	$(BIN)/mypy

docs: $(DEV)
	$(BIN)/python docs/scripts/diagrams.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/python -m mkdocs build --strict
	@echo "the documents: build/site/index.html"

$(CORE): requirements/core.txt pyproject.toml
	@test -n "$(PYTHON)" || { echo "maslam needs Python 3.11 or newer; none found as python3.11 or python3 (PYTHON=… names another)"; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP) install --quiet -r requirements/core.txt
	$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@

$(WORLDS): $(CORE) requirements/worlds.txt requirements/system-libraries.sh
	@bash requirements/system-libraries.sh
	$(PIP) install --quiet -r requirements/worlds.txt
	@touch $@

$(DEV): $(WORLDS) requirements/dev.txt
	$(PIP) install --quiet -r requirements/dev.txt
	@touch $@

# In an environment where everything passes: write down its versions.
lock: $(DEV)
	$(BIN)/python requirements/lock.py

# Which lines the tests run, worker processes included; compiled kernels are left out.
coverage: $(DEV)
	$(BIN)/python -m pytest -n 2 --cov --cov-report=term:skip-covered

# So many changed messages to agents in true states: what escapes (N=… for another number, SEED=…).
N ?= 100000
SEED ?= 0
fuzz: $(DEV)
	$(BIN)/python tests/mas/fuzz_messages.py $(N) $(SEED)

# Each attack against three presets, with the others' errors: minutes (PRESET=… for one of them).
hostile: $(DEV)
	$(BIN)/python tests/mas/hostile_table.py $(PRESET)

# Teams of processes behind relays that lose, delay and swallow what passes: minutes (TEAM=… for one of them).
relayed: $(DEV)
	$(BIN)/python tests/mas/relayed_teams.py $(TEAM)

# Whether the dependencies can be installed for each Python that is supported, without having it.
resolve: $(CORE)
	$(BIN)/python requirements/resolve.py

clean:
	rm -rf $(VENV) demo .pytest_cache .mypy_cache .ruff_cache .import_linter_cache .coverage
