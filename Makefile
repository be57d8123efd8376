# Needs Python 3.11 or newer and a C++ compiler; everything else is set up here.
PYTHON ?= python3
VENV ?= .venv
BIN := $(VENV)/bin
NATIVE := CMakeLists.txt $(wildcard src/recast/*/csrc/*)
# Two workers suit two cores; each runs torch on one thread.
WORKERS ?= 2


# Instruction sets for `make test-portable`: torch, our kernels and every BLAS held to no more.
PORTABLE_portable := ATEN_CPU_CAPABILITY=default RECAST_ISA=portable
PORTABLE_avx2 := ATEN_CPU_CAPABILITY=avx2 RECAST_ISA=avx2
LEVELS := portable
ifeq ($(shell uname -m),x86_64)
PORTABLE_portable += MKL_ENABLE_INSTRUCTIONS=SSE4_2 ONEDNN_MAX_CPU_ISA=SSE41 \
  OPENBLAS_CORETYPE=Nehalem NPY_DISABLE_CPU_FEATURES="X86_V3 X86_V4 AVX512_ICL AVX512_SPR"
PORTABLE_avx2 += MKL_ENABLE_INSTRUCTIONS=AVX2 ONEDNN_MAX_CPU_ISA=AVX2 \
  OPENBLAS_CORETYPE=Haswell NPY_DISABLE_CPU_FEATURES="X86_V4 AVX512_ICL AVX512_SPR"
ifneq ($(shell grep -om1 avx2 /proc/cpuinfo),)
LEVELS += avx2
endif
endif
# The tests whose numbers may differ between processors.
PORTABLE := tests/geometry tests/cameras tests/dynamics tests/metrics tests/splats tests/trellis \
  tests/training tests/planning/pdm tests/planning/gtrs tests/bridges/scores \
  tests/studies/test_generation_summary.py tests/studies/test_grid_summary.py
# Tests of one package or file instead: make unit TESTS=tests/splats
TESTS ?=

SIZES := src/recast bridges/src/recast_bridges tools/src/recast_tools tests
.PHONY: sizes help setup asam demo readme test test-whole test-all test-portable $(LEVELS:%=test-at-%) lint types contracts docs unit recipes fuzz bench wheel clean

help:
	@echo "make setup          install into $(VENV)"
	@echo "make demo           a made-up drive, from log to report (about seven minutes)"
	@echo "make test           lint, types, contracts, docs and unit"
	@echo "make lint           style and format of the code"
	@echo "make types          types of the code"
	@echo "make contracts      which package may import which"
	@echo "make docs           pages of the documentation, into build/site"
	@echo "make unit           tests of the parts; TESTS=tests/splats: those of one package"
	@echo "make test-whole     tests that run whole chains of commands, or kill them"
	@echo "make test-portable  tests whose numbers may differ, as on lesser processors"
	@echo "make test-at-LEVEL  the same at one LEVEL: $(LEVELS)"
	@echo "make test-all       all of them, which is what CI runs"
	@echo "make recipes        accept the code of all steps, after RECIPES were raised"
	@echo "make fuzz           100,000 damaged files for every reader; resumes"
	@echo "make bench          benchmarks of rasterizer, ray tracer and image-to-3D model"
	@echo "make readme         compare README's figures with those of the demo, made here"
	@echo "make wheel          wheels of recast-sim and recast-bridges, in dist/"
	@echo "make asam           ASAM's checkers, which some tests need, into $(ASAM)"
	@echo "make sizes          lines, files and median of each package"
	@echo "make clean          remove $(VENV), $(ASAM) and build folders"

setup: $(VENV)/.ready

# uv resolves in seconds where pip needs minutes; pip stands in where uv cannot be had.
# uv does not read pip's settings, hence the link folder by name. Compiled once here, the packages
# import in a third of the time wherever Python is told not to write bytecode.
$(VENV)/.ready: pyproject.toml bridges/pyproject.toml tools/pyproject.toml constraints.txt $(NATIVE)
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "recast needs Python 3.11 or newer")'
	@echo "setup 1/3: environment $(VENV)"
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@echo "setup 2/3: uv, which installs packages"
	@if test -x $(BIN)/uv || $(BIN)/python -m pip install -q uv; then \
	  echo "setup 3/3: packages (about 3 GB on disk) and the CPU kernel; takes minutes"; \
	  UV_FIND_LINKS="$${UV_FIND_LINKS:-$${PIP_FIND_LINKS:-}}" $(BIN)/uv pip install -q \
	    --compile-bytecode --python $(BIN)/python -c constraints.txt \
	    --reinstall-package recast-sim --reinstall-package recast-bridges --reinstall-package recast-tools \
	    -e '.[dev]' -e 'bridges[alpasim]' -e tools; \
	else \
	  echo "setup 3/3: packages (about 3 GB on disk) and the CPU kernel, with pip; takes minutes"; \
	  $(BIN)/python -m pip install -q -c constraints.txt -e '.[dev]' -e 'bridges[alpasim]' -e tools; \
	fi
	@touch $@
	@echo "setup: done; next: make demo, or $(BIN)/recast"

# ASAM's checkers want an older numpy, so they have an environment of their own. Where it cannot be
# made, the tests that need it are skipped.
ASAM := .venv-asam
asam: $(ASAM)/.ready
$(ASAM)/.ready: tests/asam-requirements.txt
	-$(PYTHON) -m venv $(ASAM) && $(ASAM)/bin/python -m pip install -q -r $< && touch $@

demo: setup
	$(BIN)/recast demo

readme: demo
	$(BIN)/python benchmarks/readme.py runs/demo/run

test: lint types contracts docs unit

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: setup
	$(BIN)/mypy

contracts: setup
	$(BIN)/lint-imports

docs: setup
	$(BIN)/mkdocs build --strict --quiet --site-dir build/site

# Neighbouring tests share costly fixtures: each worker takes a stretch, and steals when it is done.
# Bytecode is kept, whatever the environment says: collection takes half the time the next time.
PYTEST = OMP_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/python -m pytest -n $(WORKERS) --dist worksteal

unit: setup asam
	$(PYTEST) -m "not whole" --durations=10 $(TESTS)

test-whole: setup asam
	$(PYTEST) -m whole --durations=10 $(TESTS)

test-portable: $(LEVELS:%=test-at-%)

test-all: test test-whole test-portable

$(LEVELS:%=test-at-%): test-at-%: setup
	$(PORTABLE_$*) $(PYTEST) $(or $(TESTS),$(PORTABLE))

recipes: setup
	PYTHONPATH=tests $(BIN)/python tests/runs/test_recipes.py

fuzz: setup
	PYTHONPATH=tests $(BIN)/python -m fuzz.campaign --workers $(WORKERS)

bench: setup
	$(BIN)/python benchmarks/raster.py
	$(BIN)/python benchmarks/rollout.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/synthetic.py
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/trellis.py sparse
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/trellis.py actor
	OMP_NUM_THREADS=1 $(BIN)/python benchmarks/vehicle_sets.py

# The build has its own environment; its packages are found as those of `setup` are.
wheel: setup
	rm -f dist/recast_*.whl
	if test -x $(BIN)/uv; then \
	  export UV_FIND_LINKS="$${UV_FIND_LINKS:-$${PIP_FIND_LINKS:-}}"; \
	  $(BIN)/uv build --wheel --out-dir dist . && $(BIN)/uv build --wheel --out-dir dist bridges; \
	else \
	  $(BIN)/python -m pip wheel -q --no-deps --wheel-dir dist . ./bridges; \
	fi

# Lines, files and the median lines of a file, of each package.
sizes:
	@$(PYTHON) tools/sizes.py $(SIZES)

clean:
	rm -rf $(VENV) $(ASAM) build .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
