# Every target sets up what it needs: uv (found or installed into .uv/), .venv from uv.lock, then runs.
export OMP_NUM_THREADS ?= 1
export HF_HUB_OFFLINE ?= 1
export PYTHONDONTWRITEBYTECODE := # Docker images of Python set it; every process would compile torch anew.
PYTHON := .venv/bin/python
READY := .venv/.synced

.PHONY: help demo test check format build bench clean
help:  ## List the targets.
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | awk -F ':.*## ' '{printf "make %-8s %s\n", $$1, $$2}'

demo: $(READY)  ## Compare press, DexGen and DexFlex below a live operator (2 minutes on 2 cores).
	$(PYTHON) eval/compare_interfaces.py --operator=true --conditions=typical --methods=press:4,dexgen,dexflex --demo=true

test: $(READY)  ## Run all tests on 2 cores (about 8 minutes).
	$(PYTHON) -m pytest --numprocesses=2 --dist=worksteal

check: $(READY)  ## Check format, lint and types.
	.venv/bin/ruff format --check
	.venv/bin/ruff check
	.venv/bin/pyright

format: $(READY)  ## Rewrite the code in the house format.
	.venv/bin/ruff format
	.venv/bin/ruff check --fix

build: $(READY)  ## Build wheel and sdist, install each alone and smoke-test it.
	rm -rf dist
	.ci/uv build --quiet
	.ci/smoke dist/*.whl
	.ci/smoke dist/*.tar.gz

bench: $(READY)  ## Measure control steps per second beside bare physics.
	$(PYTHON) eval/bench.py

clean:  ## Remove the environment, the local uv and build products.
	rm -rf .venv .uv dist build .pytest_cache .ruff_cache

$(READY): pyproject.toml uv.lock .python-version
	.ci/uv sync --frozen
	@touch $@
