# Each target makes its own .venv on a fresh machine; nothing has to be installed before.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Processes that share the tests, file by file; 0 for none, as a debugger wants it.
WORKERS ?= 2
TESTS := $(BIN)/python tests/lanes/run.py --workers $(WORKERS)
# Images of containers often set it: then each of many processes compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help demo docs test test-numerics test-matrix test-slow test-all lint format release clean

help: ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*##/\t/'

# What is used is compiled when it is first imported; all of it would take a minute more.
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check --no-compile \
  --constraint constraints.txt --editable

$(VENV)/.made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
	  || { echo "limo needs Python 3.11 or newer; call make PYTHON=python3.11 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)
	touch $@

$(VENV)/.installed: pyproject.toml constraints.txt | $(VENV)/.made
	$(INSTALL) .
	touch $@

# For those who change limo: tests, style, types, the site. Two calls of pip take a minute more.
$(VENV)/.installed-dev: pyproject.toml constraints.txt | $(VENV)/.made
	$(INSTALL) '.[dev,docs]'
	$(BIN)/python -c 'import matplotlib.pyplot, scipy.stats, torch._dynamo' # once, not in each process
	touch $@ $(VENV)/.installed $(VENV)/.installed-docs

demo: $(VENV)/.installed ## see the whole way of the data once: out/demo/index.html
	$(BIN)/python examples/demo.py --out out/demo

# Imports limo for its reference; the examples that it shows are run once, until they change.
$(VENV)/.installed-docs: pyproject.toml constraints.txt | $(VENV)/.made
	$(INSTALL) '.[docs]'
	touch $@ $(VENV)/.installed

docs: $(VENV)/.installed-docs ## build the documentation as a site: out/site/index.html
	$(BIN)/python docs/site/gallery.py
	$(BIN)/python docs/site/notebooks.py
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet
	@echo open out/site/index.html

test: $(VENV)/.installed-dev ## run the tests that a change needs, in five minutes
	$(TESTS)

test-numerics: $(VENV)/.installed-dev ## run what hangs on arithmetic as other processors would: 2 minutes
	$(BIN)/python tests/on_other_processors.py --numprocesses $(WORKERS) --dist loadfile

test-matrix: $(VENV)/.installed-dev ## run what hangs on packages with others than the pinned, MuJoCo 3 and 4
	PYTEST_ADDOPTS="--numprocesses $(WORKERS) --dist loadfile" $(BIN)/python tests/matrix.py

test-slow: $(VENV)/.installed-dev ## run the tests that `make test` leaves out; each is marked with why
	$(TESTS) --slow

test-all: $(VENV)/.installed-dev ## run all tests, within an hour; where it was interrupted, it goes on
	$(TESTS) --all

lint: $(VENV)/.installed-dev ## style, types, direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

format: $(VENV)/.installed-dev ## mend what ruff can mend
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# A wheel is built from the source of the release, and tried in an environment of its own.
release: $(VENV)/.installed-dev docs test-matrix ## build dist/, the site in its source, and try it in an empty folder
	rm -rf dist
	$(BIN)/python -m build --outdir dist .
	$(BIN)/python -m pytest tests/install

clean: ## remove what the other targets made
	rm -rf $(VENV) out dist
