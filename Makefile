# `make demo` and `make test` set up all they need in .venv; a second time they start at once.
.DEFAULT_GOAL := help

PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
UV := $(BIN)/uv --quiet
LOCAL := -e . --no-deps --no-build-isolation

COMPILE := pip compile pyproject.toml --universal --generate-hashes --no-header --no-annotate

.PHONY: help demo test test-all lint bench bench-design bench-export bench-studies compare claims figures numbers numbers-all docs docs-check lock clean

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1 - \2/p' $(MAKEFILE_LIST) | awk -F ' - ' '{printf "%-22s%s\n", $$1, $$2}'

demo: .venv/run ## a UR5e on encoders alone picks up 5 kg: TARC and TDC side by side
	$(BIN)/tarc demo

test: .venv/dev ## all tests but the slow ones
	$(BIN)/pytest -n 2 --dist loadfile -m "not slow"

test-all: .venv/dev ## all tests
	$(BIN)/pytest -n 2 --dist loadfile

lint: .venv/dev ## style, types and the layers of the imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

bench: .venv/dev ## speed, as ratios
	$(BIN)/python -m benchmarks

bench-design: .venv/dev ## designs for six arms
	$(BIN)/python -m benchmarks.design

bench-export: .venv/dev ## exported C: bits, step time, size; the loop on the machine
	$(BIN)/python -m benchmarks.export
	$(BIN)/python -m benchmarks.runtime
	$(BIN)/python -m benchmarks.ros2

bench-studies: .venv/dev ## studies: a control period beside C by hand; from the command to the report
	$(BIN)/python -m benchmarks.studies
	$(BIN)/python -m benchmarks.studies_scaling

compare: .venv/dev ## all laws in ten scenarios
	$(BIN)/python -m benchmarks.comparison

claims: .venv/dev ## laws against TDC over draws of robot, load, friction, noise and gains, in hours; resumes
	$(BIN)/python -m benchmarks.claims

figures: .venv/dev ## draw the figures of the documentation again
	$(BIN)/python docs/images/make.py

numbers: .venv/dev ## write the numbers of README and documentation again, in minutes
	$(BIN)/python -m benchmarks.numbers

numbers-all: .venv/dev ## the same with the numbers that take hours
	$(BIN)/python -m benchmarks.numbers --all

docs: .venv/dev ## build the documentation into site/
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

docs-check: docs ## build the documentation and run its code
	$(BIN)/pytest docs README.md
	$(BIN)/pytest -m "not slow" tests/meta

# The demo's versions first, then those of the tests, which agree with them; UPGRADE=--upgrade takes the newest ones.
lock: .venv/uv ## pin the versions that pyproject.toml allows, with hashes
	$(UV) $(COMPILE) --extra cli --extra view --group build $(UPGRADE) -o requirements.lock
	$(UV) $(COMPILE) --extra all --group dev $(UPGRADE) --constraint requirements.lock -o requirements-dev.lock

clean: ## remove .venv, caches and results
	rm -rf .venv site runs dist .pytest_cache .ruff_cache .import_linter_cache .hypothesis docs/.ruff_cache

.venv/uv:
	$(PYTHON) -m venv .venv
	$(BIN)/python -m pip install --quiet --disable-pip-version-check uv==0.13.9
	touch $@

.venv/run: .venv/uv requirements.lock pyproject.toml
	@echo "setting up .venv (once; a minute or so)"
	$(UV) pip install --compile-bytecode --python $(BIN)/python --require-hashes -r requirements.lock
	$(UV) pip install --python $(BIN)/python $(LOCAL)
	touch $@

.venv/dev: .venv/run requirements-dev.lock
	@echo "adding what the tests need"
	$(UV) pip install --compile-bytecode --python $(BIN)/python --require-hashes -r requirements-dev.lock
	touch $@
