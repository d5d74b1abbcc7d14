# make demo      set everything up and show the whole way: simulate, tune, evaluate, pictures
# make test      set everything up and run the tests
# make install   set the command up, and nothing else: source .venv/bin/activate
# make test-long  run the cases that the tests leave out to be quick
# make check     style, types, layers, prose
# make bench     measure, side by side with the rivals, and write docs/benchmarks.md
# make parity    how closely the filters agree, over a whole drive
# make fuzz      break logs of every format by chance for so long: make fuzz MINUTES=30; then read 6000 odd tables
# make docs      build the site into docs/_build: open docs/_build/html/index.html
# make pictures  make the site's pictures anew: the demo's, the workbench's, and those of measured figures
# make dist      build wheel and sdist into dist/
# make dist-check  try the wheel on each Python that is found, each in an empty environment
# make carla-recorder  write the recorder for old CARLA servers as one file, dist/carla_recorder.pyz
# make notebook  execute examples/paper.ipynb and keep its outputs in it

PYTHON ?= python3
MINUTES ?= 30
VENV := .venv
DOCS := .venv-docs
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

# Without bytecode each of the hundreds of processes that the tests start would parse all sources anew.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo install test test-long check bench parity fuzz docs pictures dist dist-check carla-recorder notebook clean

demo: $(VENV)/installed
	$(BIN)/sigmaswarm demo --out demo
	@echo "the command:  source $(BIN)/activate"
	@echo "your own log: pip install -e '.[workbench]', then sigmaswarm workbench LOG opens it in the browser"

install: $(VENV)/installed
	@echo "installed; next: source $(BIN)/activate, then sigmaswarm --help"

test: $(VENV)/test-installed
	$(BIN)/python tests/warm.py
	$(BIN)/python -m pytest -n auto --dist worksteal

test-long: $(VENV)/test-installed
	$(BIN)/python tests/warm.py
	HYPOTHESIS_PROFILE=long $(BIN)/python -m pytest -n auto --dist worksteal -m "long or hypothesis"

check: $(VENV)/check-installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/lint-imports
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/python tests/prose.py

bench: $(VENV)/bench-installed
	$(BIN)/python benchmarks/table.py

parity: $(VENV)/test-installed
	$(BIN)/python benchmarks/parity.py

fuzz: $(VENV)/test-installed
	cd tests && ../$(BIN)/python -m fuzzing --minutes $(MINUTES) --found ../fuzz-found
	cd tests && ../$(BIN)/python -m fuzzing.records --inputs 500 --found ../fuzz-found
	cd tests && ../$(BIN)/python -m fuzzing.live --sequences 500
	$(BIN)/python -m pytest -q -m long tests/importing/test_odd_tables.py

docs: $(DOCS)/installed
	$(DOCS)/bin/sphinx-build --fail-on-warning --keep-going --quiet --jobs auto --conf-dir docs . docs/_build/html
	@echo "open docs/_build/html/index.html"

pictures: $(VENV)/test-installed
	$(BIN)/python docs/pictures.py

dist: $(VENV)/release-installed
	rm -rf dist
	$(BIN)/python -m build --outdir dist

dist-check: dist
	$(PYTHON) tests/installed.py dist

carla-recorder: $(VENV)/installed
	mkdir -p dist
	$(BIN)/python -m sigmaswarm_carla.pack dist/carla_recorder.pyz

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

# constraints.txt holds here, too, but for what docs/constraints.txt says otherwise.
$(DOCS)/installed: pyproject.toml constraints.txt docs/constraints.txt
	$(PYTHON) -m venv $(DOCS)
	cut -d= -f1 docs/constraints.txt | grep -v '^#' | sed 's/$$/==/' > $(DOCS)/said
	{ grep -v -i -F -f $(DOCS)/said constraints.txt; cat docs/constraints.txt; } > $(DOCS)/constraints.txt
	$(DOCS)/bin/python -m pip install --quiet --disable-pip-version-check --constraint $(DOCS)/constraints.txt pip
	$(DOCS)/bin/python -m pip install --quiet --disable-pip-version-check --constraint $(DOCS)/constraints.txt --editable . --group docs
	touch $@

clean:
	rm -rf $(VENV) $(DOCS) docs/_build docs/reference/generated dist demo .pytest_cache .ruff_cache .hypothesis
