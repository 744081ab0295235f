# make demo · hil · test · lint · honesty · plant · bench · soak: each makes its own .venv first. PYTHON=python3.12 chooses the interpreter.
PYTHON ?= python3
BIN := .venv/bin
export NUMBA_CACHE_DIR ?= $(CURDIR)/.numba_cache
export PYBAMM_DISABLE_TELEMETRY := true

.PHONY: demo hil test lint honesty ratchet plant bench soak clean

demo: .venv/runtime
	$(BIN)/bms-ukf demo

hil: .venv/runtime
	$(BIN)/bms-ukf hil tests/hil --jobs 2 --junit hil.xml --report hil.html

test: lint
	$(BIN)/python -m pytest -m "not socketcan and not bench" --numprocesses auto --dist loadfile
	$(BIN)/python tests/socketcan/run.py

lint: .venv/test
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

honesty: .venv/runtime
	$(BIN)/bms-ukf campaign --report honesty.html --json honesty.json

# What the quick campaign in `make test` may not fall behind, measured again.
ratchet: .venv/runtime
	PYTHONPATH=tests/reference $(BIN)/python -m honesty_gate

plant: .venv/runtime compiler
	$(BIN)/python -m bms_ukf.fmumaker models/lgm50_spme models/plants/lgm50_spme.fmu
	$(BIN)/python -m bms_ukf.fmumaker models/pack_96s models/plants/pack_96s.fmu

bench: .venv/test compiler
	$(BIN)/python -m pip install --quiet --editable '.[bench]'
	$(BIN)/python -m pytest -m bench tests/bench

soak: .venv/test
	PYTHONPATH=tests/reference $(BIN)/python -m soak 1e8
	PYTHONPATH=tests/reference $(BIN)/python -m fuzz 1e6
	PYTHONPATH=tests/reference $(BIN)/python -m frame_soak 1e7
	$(BIN)/python -m pip install --quiet --editable '.[fuzz]'
	PYTHONPATH=tests/reference $(BIN)/python -m guided_fuzz -runs=1000000 -max_len=72
	BMS_UKF_KILLS=1000 $(BIN)/python -m pytest tests/test_slots.py -k kill

clean:
	rm -rf .venv .numba_cache

.venv/runtime: .venv/made pyproject.toml
	@echo "== installing bms-ukf and what it needs into .venv (once)"
	$(BIN)/python -m pip install --editable .
	@touch $@

.venv/test: .venv/made pyproject.toml
	@echo "== installing bms-ukf, its test tools and PyBaMM into .venv (once; 1.4 GB)"
	$(BIN)/python -m pip install --editable '.[test,plant]'
	@touch $@ .venv/runtime

.venv/made:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "bms-ukf needs Python 3.11 or newer;\
	 $(PYTHON) is `$(PYTHON) --version 2>&1`. Install one (apt install python3.12 python3.12-venv) and use\
	 make PYTHON=python3.12"; exit 2; }
	@$(PYTHON) -c 'import ensurepip, venv' || { echo "$(PYTHON) has no venv: apt install python3-venv"; exit 2; }
	$(PYTHON) -m venv --clear .venv
	@touch $@

.PHONY: compiler
compiler:
	@command -v $(CC) >/dev/null || { echo "a C compiler is needed: apt install gcc libc6-dev"; exit 2; }
