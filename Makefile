# Everything a fresh machine with Python 3.11 and make needs. `make demo` and `make test` set themselves up.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
# One worker more than there are cores, since some tests wait; up to four, since each takes two gigabytes.
WORKERS := -n $$($(BIN)/python -c 'import os; print(min(os.cpu_count() + 1, 4))')
# A file of tests stays in one worker: what it makes for all of its tests is made once, and compiled once.
SIDE_BY_SIDE := $(WORKERS) --dist loadfile
# Of the slow tests one file takes a quarter of the time: a worker that has done its own takes over some of the other's.
# A worker grows by two megabytes a test, which JAX does not give back: whole studies, which need most, have workers of their own,
# and so have the largest examples.
WHOLE_EXAMPLES := tests/examples/test_examples.py tests/examples/test_real_wall.py
TAKEN_OVER := $(WORKERS) --dist worksteal
# Every core has its worker: threads of the linear algebra would only wait for one another.
ONE_THREAD := OPENBLAS_NUM_THREADS=1
# Compiling was half of the time of the quick tests, and a quarter of that of the slow ones: how both compile is
# in tests/helpers/plain_code.py.
COMPILING := $(BIN)/python -c 'import sys; sys.path.append("tests/helpers"); import plain_code; print(getattr(plain_code, sys.argv[1]))'

.PHONY: demo test test-slow docs package lint format bench lock clean

demo: $(READY)
	$(BIN)/structid demo --out demo

test: $(READY)
	@echo "Tests of behaviour, several files at a time, without whole studies and what else takes long (make test-slow) and without style (make lint):"
	$(ONE_THREAD) XLA_FLAGS="$$($(COMPILING) QUICK_TESTS)" $(BIN)/pytest $(SIDE_BY_SIDE) -q -m "not slow"

test-slow: $(READY)
	@echo "Whole studies, statistics, kills, examples and quick runs of every benchmark, several tests at a time:"
	$(ONE_THREAD) XLA_FLAGS="$$($(COMPILING) SLOW_TESTS)" $(BIN)/pytest $(TAKEN_OVER) -q -m slow $(WHOLE_EXAMPLES)
	$(ONE_THREAD) XLA_FLAGS="$$($(COMPILING) SLOW_TESTS)" $(BIN)/pytest $(TAKEN_OVER) -q -m slow tests/study
	$(ONE_THREAD) XLA_FLAGS="$$($(COMPILING) SLOW_TESTS)" $(BIN)/pytest $(TAKEN_OVER) -q -m slow $(addprefix --ignore ,$(WHOLE_EXAMPLES) tests/study)

# The site: its examples are executed, a warning is an error, and no network is needed once the tools are installed.
docs: $(VENV)/ready-docs
	$(BIN)/sphinx-build --quiet --fail-on-warning --keep-going -b html docs docs/_build/html
	$(BIN)/python docs/_ext/checked_links.py docs/_build/html

# What a release publishes: source distribution, wheel, and a bill of materials (CycloneDX) of the lock.
package: $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check "cyclonedx-bom>=7"
	rm -rf dist && $(BIN)/hatchling build
	$(BIN)/cyclonedx-py requirements requirements.lock --pyproject pyproject.toml --output-reproducible -o dist/structid.cdx.json

lint: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/mypy --config-file tools/mypy_scripts.ini
	$(BIN)/lint-imports
	$(BIN)/python tools/check_style.py

format: $(READY)
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

# The peers (OpenSeesPy, numba) are installed only here; OpenSeesPy also needs Debian's libblas3.
bench: $(READY)
	$(BIN)/pip install --quiet --disable-pip-version-check "numba>=0.60" "openseespy>=3.5"
	$(BIN)/python benchmarks/lanes.py
	$(BIN)/python benchmarks/forward_model.py
	$(BIN)/python benchmarks/reference_inversion.py

$(READY): pyproject.toml requirements.lock
	$(PYTHON) -c "import sys; sys.exit(sys.version_info < (3, 11) and 'structid needs Python 3.11 or newer: make PYTHON=/path/to/python3.11')"
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	touch $(READY)

$(VENV)/ready-docs: $(READY) docs/requirements.lock
	$(BIN)/pip install --quiet --disable-pip-version-check --require-hashes -r docs/requirements.lock
	touch $@

lock:
	uv pip compile --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --group pyproject.toml:test --group pyproject.toml:lint --group pyproject.toml:build pyproject.toml -o requirements.lock
	uv pip compile --universal --generate-hashes --no-emit-index-url --no-header --python-version 3.11 \
	  --group pyproject.toml:docs --constraints requirements.lock -o docs/requirements.lock

clean:
	rm -rf $(VENV) demo demo.toml build dist docs/_build
