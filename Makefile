# `make demo` and `make test` are all that is needed. `make help` lists the rest.
VENV := .venv
BIN := $(VENV)/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check
UV ?= uv
MARKS ?= not slow
# The numeric libraries must not each start as many threads as there are cores: two test processes share them.
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1

.PHONY: help demo test test-all lint bench bench-carry docs lock clean

help:
	@echo "make demo      environment, installation, the whole job on the bundled data; says which files to open"
	@echo "make test      linter, formatter, types, import rules, tests"
	@echo "make test-all  the same with the slow tests"
	@echo "make bench     start-up and whole-job times, side by side with a yardstick"
	@echo "make bench-carry  the default model on many machines against simple baselines (see docs/carrying_over.md)"
	@echo "make docs      the documents as HTML in docs/_build/html"
	@echo "make lock      resolve the locked dependencies anew (needs uv)"
	@echo "make clean     remove the environment and everything generated"

demo: $(VENV)/.package
	@$(BIN)/thetacomp demo

test: $(VENV)/.dev $(VENV)/.package lint
	@scripts/system_packages.sh
	$(ONE_THREAD) $(BIN)/python -m pytest -n 2 --dist loadscope -m "$(MARKS)"

# `slow or not slow` marks every test.
test-all: MARKS := slow or not slow
test-all: test

lint: $(VENV)/.dev $(VENV)/.package
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports --no-cache

bench: $(VENV)/.package
	@$(BIN)/python bench/run.py

bench-carry: $(VENV)/.package
	@$(ONE_THREAD) $(BIN)/python bench/carry.py --jobs 2 --page docs/carrying_over.md

docs: $(VENV)/.dev
	$(BIN)/sphinx-build -W -q docs docs/_build/html
	@echo "open docs/_build/html/index.html"

# Base for users, base and every extra for the tests; both locked to the same versions.
LOCK = $(UV) pip compile --universal --generate-hashes --python-version 3.11 --upgrade --no-annotate --quiet \
  --no-emit-index-url --no-emit-find-links --no-emit-package thetacomp --custom-compile-command "make lock" pyproject.toml

lock:
	$(LOCK) --group build -o requirements.txt
	$(LOCK) --group dev --all-extras -c requirements.txt -o requirements-dev.txt

clean:
	rm -rf $(VENV) thetacomp-demo docs/_build build dist .pytest_cache .mypy_cache .ruff_cache .hypothesis

# The environment is made anew when the locked requirements change; wheels only, so no compiler is needed. `make demo`
# installs what a user installs, without extras; the tests need all of them.
$(VENV)/.runtime: requirements.txt scripts/make_venv.sh
	@scripts/make_venv.sh $(VENV)
	@echo "make: installing the locked dependencies"
	@$(PIP) install --quiet --require-hashes --only-binary :all: -r requirements.txt
	@touch $@

$(VENV)/.dev: $(VENV)/.runtime requirements-dev.txt
	@echo "make: installing the locked tools for tests"
	@$(PIP) install --quiet --require-hashes --only-binary :all: -r requirements-dev.txt
	@touch $@

$(VENV)/.package: $(VENV)/.runtime pyproject.toml src/thetacomp/__init__.py
	@$(PIP) install --quiet --no-deps --no-build-isolation --editable .
	@touch $@
