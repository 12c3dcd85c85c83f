# One command per job; each installs what it needs into .venv and does so once. -qq: pip shows its errors, but not its
# warnings, which are about the machine's own settings of pip.
PYTHON ?= python3
PY := .venv/bin/python
INSTALL := $(PY) -m pip install -qq --disable-pip-version-check -c constraints.txt
PINS := pyproject.toml constraints.txt
.DEFAULT_GOAL := help
.PHONY: help setup demo test docs test-bounds coverage test-ray train-torchrl train-benchmarl soak check clean

help: ## list the commands
	@grep -E '^[a-z-]+:.*##' Makefile | sed -E 's/^([a-z-]+):.*## /  make \1 \t/' | expand -t 20

.venv/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { echo "twc_env needs Python 3.11 or newer; name one: make PYTHON=python3.11 ..."; exit 1; }
	@$(PYTHON) -m venv .venv || { rm -rf .venv; exit 1; }

.venv/installed-demo: $(PINS) | .venv/bin/python
	@echo "installing into .venv (a minute or more)"
	@$(INSTALL) -e '.[viz]'
	@touch $@

.venv/installed-dev: $(PINS) | .venv/bin/python
	@echo "installing into .venv (a minute or more)"
	@$(INSTALL) -e '.[viz,dev]'
	@touch $@

.venv/installed-test: $(PINS) | .venv/bin/python
	@echo "installing torch and more into .venv (several minutes)"
	@$(INSTALL) torch -e '.[viz,dev,train,ocr]'
	@$(INSTALL) -e '.[viz,ros,docs]' || echo "rosbags or mkdocs-material is not to be had here: their tests are skipped"
	@$(INSTALL) -e '.[torchrl,rerun]' sb3-contrib || echo "TorchRL, Rerun or sb3-contrib is not to be had here: their tests are skipped"
	@touch $@

setup: .venv/installed-dev ## .venv with everything but torch

demo: .venv/installed-demo ## three robots explore twin-01: table, map.png and a film in runs/demo
	.venv/bin/twc-env explore --map twin-01 --out runs/demo
	@echo "The picture: runs/demo/map.png   The film: runs/demo/twin-01-seed0.gif"

check: .venv/installed-dev ## format, lint, types, import arrows and costs
	$(PY) -m ruff format --check .
	$(PY) -m ruff check .
	$(PY) -m mypy
	$(PY) -m pytest -q tests/test_architecture.py tests/test_import.py
	$(PY) -m pytest -q -m timed tests/world/building tests/planning tests/exploration/drawing

test: .venv/installed-test ## all tests, training and OCR included (installs torch and onnxruntime)
	.venv/bin/twc-env warm-up
	$(PY) -m pytest -q -n auto --maxprocesses 4 --dist worksteal

.venv/installed-docs: $(PINS) | .venv/bin/python
	@echo "installing into .venv (a minute or more)"
	@$(INSTALL) -e '.[viz,docs]'
	@touch $@

docs: .venv/installed-docs ## the documentation site in build/site, built strictly (open index.html)
	NO_MKDOCS_2_WARNING=1 $(PY) -m mkdocs build --strict
	@echo "The site: build/site/index.html"

test-bounds: .venv/installed-test ## the engine's tests with numba's bounds checks (own kernel cache; slow)
	NUMBA_BOUNDSCHECK=1 NUMBA_CACHE_DIR=.numba_bounds $(PY) -m pytest -q -n auto --maxprocesses 4 --dist worksteal tests/slam tests/exploration

coverage: .venv/installed-test ## lines that the tests run, room by room, but for reproduce and compiled kernels (an hour of a core); goes on where it was
	@mkdir -p runs/coverage
	@for part in tests/*/ tests/test_*.py; do \
		mark=runs/coverage/$$(basename $$part); [ -f $$mark ] && continue; \
		COVERAGE_FILE=runs/coverage/.coverage $(PY) -m coverage run -m pytest -q $$part && touch $$mark; \
	done
	COVERAGE_FILE=runs/coverage/.coverage $(PY) -m coverage combine --keep -q runs/coverage
	COVERAGE_FILE=runs/coverage/.coverage $(PY) -m coverage report

soak: .venv/installed-test ## hours: 1,000,000 steps, malformed input of every kind, observations; counts in runs/soak
	$(PY) -m tests.soak --actions 100000 --maps 10000 --logs 10000 --bags 10000 --tables 10000 --settings 10000 \
		--graphs 10000 --arrays 10000 --calls 10000 --bombs 50 --doors 1000 --accidents 74 --instructions 140 \
		--observations 10000 --resume runs/soak/rows.jsonl --json runs/soak/trust.json
	$(PY) -m tests.soak --steps 1000000 --resume runs/soak/episodes.jsonl --json runs/soak/trust.json

.venv-ray/installed: pyproject.toml
	@$(PYTHON) -m venv .venv-ray || { rm -rf .venv-ray; exit 1; }
	@echo "installing ray into .venv-ray (several minutes)"
	@.venv-ray/bin/python -m pip install -qq --disable-pip-version-check -e '.[ray,viz,train]' torch==2.13.0 pytest hypothesis
	@touch $@

test-ray: .venv-ray/installed ## RLlib trains a team, Ray plays a benchmark (in .venv-ray: ray asks for an older gymnasium)
	.venv-ray/bin/python -c 'import ray.rllib'
	.venv-ray/bin/python -m pytest -q -k "rllib or RLlib" tests/vector/test_tools.py tests/docs/test_snippets.py
	.venv-ray/bin/python -m pytest -q tests/running/test_ray_cluster.py tests/suite/test_ray.py tests/vector/test_ray_pool.py tests/training/test_resuming.py
	.venv-ray/bin/python docs/tutorials/rllib_ppo.py 1200 runs/rllib twc/ExploreQuick-v1

.venv-benchmarl/installed: pyproject.toml
	@$(PYTHON) -m venv .venv-benchmarl || { rm -rf .venv-benchmarl; exit 1; }
	@echo "installing BenchMARL into .venv-benchmarl (several minutes)"
	@.venv-benchmarl/bin/python -m pip install -qq --disable-pip-version-check -e '.[viz]' 'benchmarl>=1.5' torch==2.13.0
	@touch $@

train-benchmarl: .venv-benchmarl/installed ## BenchMARL trains MAPPO on a task v1 (in .venv-benchmarl: it asks for an older TorchRL)
	.venv-benchmarl/bin/python docs/tutorials/benchmarl_mappo.py 1200 runs/benchmarl twc/ExploreQuick-v1

train-torchrl: .venv/installed-test ## TorchRL trains PPO on a task v1
	$(PY) docs/tutorials/torchrl_ppo.py 1200 runs/torchrl twc/ExploreQuick-v1

clean: ## delete caches and runs, keep .venv
	rm -rf runs build dist .numba_bounds .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -not -path './.venv*' -prune -exec rm -rf {} +
