# ArtiWorld needs Python 3.11 or newer, make and (on Debian or Ubuntu) apt; the rest installs itself.
#   make run              start the server with the bundled examples
#   make run ARGS=PATH…   start it with your own files
#   make test             all tests, in a real browser too
#   make test-fast        those that take a minute: no browser, physics or training;
#                         KERNEL=other: as on a processor without AVX
#   make lint             style, types, layers, and the budget of lines
#   make docs             build the documentation site into build/site
#   make pictures         take the pictures of the documents anew

PYTHON ?= $(shell for p in python3.11 python3.12 python3.13 python3; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && { echo $$p; break; }; done)
VENV ?= .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --quiet
# Two workers a browser is plenty: more only wait for each other.
WORKERS ?= $(shell n=$$(nproc 2>/dev/null || echo 2); [ $$n -gt 4 ] && n=4; echo $$n)
# A file stays on one worker, as its tests share fixtures; tests/conftest.py puts long ones first.
PYTEST := $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile --no-loadscope-reorder
ARGS ?=
TESTS ?= tests
KERNEL ?= own
ifeq ($(KERNEL),other)
export OPENBLAS_CORETYPE := Prescott
export NPY_DISABLE_CPU_FEATURES := X86_V3 X86_V4 AVX512_ICL AVX512_SPR
export ATEN_CPU_CAPABILITY := default
endif

.DEFAULT_GOAL := help
.PHONY: help run install test test-fast lint format docs pictures clean

help:
	@sed -n '1,9s/^# \{0,1\}//p' Makefile

run: $(VENV)/.run
	@$(BIN)/artiworld serve $(ARGS)

install: $(VENV)/.run

test: $(VENV)/.test
	@.ci/need 'command -v chromium || command -v chromium-browser || command -v google-chrome' chromium \
		|| { echo 'The browser tests will be skipped.' >&2; [ -z "$$CI" ]; }
	$(PYTEST) $(TESTS)

test-fast: $(VENV)/.test
	$(PYTEST) -q -m "not slow" $(TESTS)

lint: $(VENV)/.lint
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright --pythonpath $(BIN)/python
	$(BIN)/lint-imports
	$(BIN)/python -m tests.budget

format: $(VENV)/.lint
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# Opens from the disk, without a network; a broken link or a warning fails.
docs: $(VENV)/.docs
	$(BIN)/python docs/build_site.py
	@echo 'The site: build/site/index.html'

# All, or ARGS="joints review"; the gallery is the same again unless generated objects changed.
pictures: $(VENV)/.test
	@.ci/need 'command -v chromium || command -v chromium-browser || command -v google-chrome' chromium
	$(BIN)/python -m tests.browser.pictures $(ARGS)
	$(BIN)/python -m tests.gallery

clean:
	rm -rf $(VENV) build dist *.egg-info .pytest_cache .ruff_cache .import_linter_cache .hypothesis .cache
	find app model sessions tests -name __pycache__ -type d -prune -exec rm -rf {} +

# A stamp says what was installed; it is newer than what it was installed from.

$(VENV)/.made:
	@[ -n "$(PYTHON)" ] || { echo 'Python 3.11 or newer is needed: apt-get install python3.11 python3.11-venv' >&2; exit 1; }
	@.ci/need "$(PYTHON) -c 'import ensurepip, venv'" python3-venv
	@echo 'Making $(VENV) with $(PYTHON)'
	@$(PYTHON) -m venv $(VENV)
	@touch $@

$(VENV)/.run: pyproject.toml constraints.txt | $(VENV)/.made
	@echo 'Installing ArtiWorld (the first time this takes some minutes)'
	@$(PIP) install --constraint constraints.txt --editable .
	@.ci/need '$(BIN)/python -c "import open3d"' libgl1 libegl1 libgomp1 libx11-6 libusb-1.0-0
	@touch $@

$(VENV)/.test: pyproject.toml constraints.txt | $(VENV)/.run
	@echo 'Installing what the tests need'
	@$(PIP) install --constraint constraints.txt --editable '.[test]'
	@touch $@

$(VENV)/.lint: pyproject.toml constraints.txt | $(VENV)/.test
	@echo 'Installing what the checks need'
	@$(PIP) install --constraint constraints.txt --editable '.[lint]'
	@touch $@

$(VENV)/.docs: pyproject.toml constraints.txt | $(VENV)/.run
	@echo 'Installing what the documentation site needs'
	@$(PIP) install --constraint constraints.txt --editable '.[docs]'
	@touch $@
