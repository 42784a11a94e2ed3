# loopcal needs Python 3.11 or newer and make; everything else is installed into .venv.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo test check lint format types contracts lock samples proto clean

demo: $(VENV)/.run-ready  ## both mechanisms: virtual devices, capture, solve, report
	$(BIN)/loopcal demo

# Every core has a test of its own, so that more threads only wait for each other; and the many processes
# that tests start need not compile the project anew.
test: $(VENV)/.dev-ready  ## the tests
	OPENBLAS_NUM_THREADS=1 PYTHONDONTWRITEBYTECODE= $(BIN)/pytest -n auto --dist loadfile --max-worker-restart 1

check: lint types contracts test  ## what CI runs

lint: $(VENV)/.dev-ready
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(VENV)/.dev-ready
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

types: $(VENV)/.dev-ready
	$(BIN)/mypy

contracts: $(VENV)/.dev-ready
	$(BIN)/lint-imports --no-cache

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' \
		|| { echo "loopcal needs Python 3.11 or newer; '$(PYTHON)' is $$($(PYTHON) --version 2>&1). Set PYTHON=/path/to/python3"; exit 2; }
	@$(PYTHON) -m venv $(VENV) \
		|| { echo "'$(PYTHON) -m venv' failed; on Debian and Ubuntu install the package python3-venv"; exit 2; }

$(VENV)/.run-ready: requirements.lock pyproject.toml | $(VENV)/bin/python
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	@touch $@

$(VENV)/.dev-ready: requirements-dev.lock $(VENV)/.run-ready
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements-dev.lock
	@touch $@

lock:  ## renew the locked dependencies (needs uv)
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
		pyproject.toml --group build -o requirements.lock
	uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-emit-index-url \
		pyproject.toml --group dev -o requirements-dev.lock

clean:
	rm -rf $(VENV) demo-output

samples: $(VENV)/.run-ready  ## write recordings/samples again
	rm -f recordings/samples/*.mcap recordings/samples/*.json
	for rig in arm shoulder; do \
		$(BIN)/loopcal simulate $$rig -o recordings/samples/$$rig.mcap --seed 2026 \
			--truth recordings/samples/$$rig.truth.json || exit 1; \
	done

proto: $(VENV)/.dev-ready  ## generate the protobuf code; see the head of recordings/messages.proto
	$(BIN)/python -m grpc_tools.protoc -I. --python_out=. --pyi_out=. recordings/messages.proto
