# make demo      set everything up and show the whole way: simulate, tune, evaluate, pictures
# make test      set everything up and run the tests
# make check     the checks beside the tests: style, types, layers
# make bench     measure, side by side with the rivals, and write docs/benchmarks.md
# make parity    how closely the filters agree, over a whole drive
# make fuzz      break logs of every format by chance for so long: make fuzz MINUTES=30
# make notebook  execute examples/paper.ipynb and keep its outputs in it

PYTHON ?= python3
MINUTES ?= 30
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test check bench parity fuzz notebook clean

demo: $(VENV)/installed
	$(BIN)/sigmaswarm demo --out demo

test: $(VENV)/test-installed
	$(BIN)/python tests/warm.py
	$(BIN)/python -m pytest -n auto

check: $(VENV)/check-installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python

bench: $(VENV)/bench-installed
	$(BIN)/python benchmarks/table.py

parity: $(VENV)/test-installed
	$(BIN)/python benchmarks/parity.py

fuzz: $(VENV)/test-installed
	cd tests && ../$(BIN)/python -m fuzzing --minutes $(MINUTES) --found ../fuzz-found

notebook: $(VENV)/test-installed
	$(BIN)/python examples/execute.py examples/paper.ipynb

$(VENV)/installed: pyproject.toml constraints.txt
	$(PYTHON) -c 'import sys; sys.exit("sigmaswarm needs Python 3.11 to 3.13" if not (3, 11) <= sys.version_info[:2] <= (3, 13) else 0)'
	$(PYTHON) -m venv $(VENV)
	$(PIP) pip # an old pip knows no dependency groups
	$(PIP) --editable .
	touch $@

$(VENV)/%-installed: $(VENV)/installed
	$(PIP) --group $*
	touch $@

# The checks read the tests and benchmarks too, so they need what those import.
$(VENV)/check-installed: $(VENV)/test-installed
	$(PIP) --group check
	touch $@

clean:
	rm -rf $(VENV) demo .pytest_cache .ruff_cache .hypothesis
