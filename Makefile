# Everything a developer types, in one place: `make` alone lists it.
.DEFAULT_GOAL := help
PYTHON ?= .venv/bin/python
COMPILE = uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-header \
	--no-emit-index-url --no-emit-find-links --no-annotate

.PHONY: help
help: ## list the targets
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  %-10s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

.PHONY: run
run: ## three robots map the shipped office, with a report (options: ARGS="--robots 2")
	sh deploy/run.sh $(ARGS)

.PHONY: test
test: ## all checks and tests but the slow ones, as CI runs them
	sh deploy/test.sh

.PHONY: test-all
test-all: ## the slow statistical tests too
	sh deploy/test.sh --all

.PHONY: format
format: ## format the code, and mend what ruff can
	$(PYTHON) -m ruff format .
	$(PYTHON) -m ruff check --fix .

.PHONY: lint
lint: ## ruff, mypy and the import walls
	$(PYTHON) -m ruff check .
	$(PYTHON) -m ruff format --check .
	$(PYTHON) -m mypy
	$(PYTHON) -c "from importlinter.cli import lint_imports_command; lint_imports_command()"

.PHONY: lock
lock: ## renew the locked versions from pyproject.toml (needs uv)
	echo 'setuptools>=77' | $(COMPILE) pyproject.toml - --output-file deploy/requirements.lock
	echo 'setuptools>=77' | $(COMPILE) --extra dev --constraint deploy/requirements.lock \
		pyproject.toml - --output-file deploy/requirements-dev.lock

.PHONY: image
image: ## build the container image
	docker build --file deploy/Dockerfile --tag earshot .

.PHONY: clean
clean: ## remove the environment, caches and reports
	rm -rf .venv .mypy_cache .ruff_cache .pytest_cache .import_linter_cache .hypothesis runs
