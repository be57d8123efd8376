# Needs Python 3.11 or newer and a C++ compiler; everything else is set up here.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := CMakeLists.txt $(wildcard src/recast/splats/csrc/*)
# Two workers suit two cores; each runs torch on one thread.
WORKERS ?= 2

.PHONY: help setup demo test lint types contracts unit bench clean

help:
	@echo "make setup   install into $(VENV)"
	@echo "make demo    a made-up drive, from log to report (about twelve minutes)"
	@echo "make test    lint, types, layer contracts and the tests (what CI runs)"
	@echo "make bench   the benchmarks of rasterizer, ray tracer and image-to-3D model"
	@echo "make clean   remove $(VENV) and build folders"

setup: $(VENV)/.ready

# uv resolves in seconds where pip needs minutes; pip stands in where uv cannot be had.
# uv does not read pip's settings, hence the link folder by name.
$(VENV)/.ready: pyproject.toml constraints.txt $(NATIVE)
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "recast needs Python 3.11 or newer")'
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	if test -x $(BIN)/uv || $(BIN)/python -m pip install -q uv; then \
	  UV_FIND_LINKS="$${UV_FIND_LINKS:-$${PIP_FIND_LINKS:-}}" $(BIN)/uv pip install -q \
	    --python $(BIN)/python -c constraints.txt --reinstall-package recast-sim -e '.[dev]'; \
	else \
	  $(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]'; \
	fi
	touch $@

demo: setup
	$(BIN)/recast demo

test: lint types contracts unit

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

contracts: setup
	$(BIN)/lint-imports

unit: setup
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n $(WORKERS) --durations=10

bench: setup
	$(BIN)/python benchmarks/raster.py
	$(BIN)/python benchmarks/rollout.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/synthetic.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/trellis.py sparse
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/trellis.py actor

clean:
	rm -rf $(VENV) build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
