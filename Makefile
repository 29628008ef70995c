# `make demo` and `make test` set up all they need in .venv; a second time they start at once.
PYTHON ?= $(shell command -v python3.11 || command -v python3)
BIN := .venv/bin
UV := $(BIN)/uv --quiet
LOCAL := -e . --no-deps --no-build-isolation

.PHONY: demo test lint bench bench-design compare docs docs-check lock clean

demo: .venv/run
	$(BIN)/tarc demo

test: .venv/dev
	$(BIN)/pytest -n 2 --dist loadfile

lint: .venv/dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports

bench: .venv/dev
	$(BIN)/python -m benchmarks

bench-design: .venv/dev
	$(BIN)/python -m benchmarks.design

compare: .venv/dev
	$(BIN)/python -m benchmarks.comparison

docs: .venv/dev
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict --quiet

docs-check: docs
	$(BIN)/pytest docs README.md tests/meta

# Newest versions that the bounds in pyproject.toml allow, with hashes.
lock: .venv/uv
	$(UV) pip compile pyproject.toml --group build --universal --generate-hashes --no-header --no-annotate --upgrade -o requirements.lock
	$(UV) pip compile pyproject.toml --group dev --universal --generate-hashes --no-header --no-annotate \
		--constraint requirements.lock -o requirements-dev.lock

clean:
	rm -rf docs/.ruff_cache .venv site runs .pytest_cache .ruff_cache .hypothesis

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
