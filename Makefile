# make install                        .venv with iher-robot in it, and nothing else
# make train                          learn Push on the simulated robot
# make train TASK=reach ARGS="..."    another task, more options of `iher-robot train`
# make test                           the test suite; ARGS="-k name" selects
# make test-full                      the same with 10,000 safety sequences, as CI runs it
# make test-ray                       experiments on a Ray cluster of nodes on this machine
# make check                          format, lint, types, floors
# make bench                          speeds on this machine against rivals (python -m bench.speed)
# make bench-sbx                      install sbx (JAX), one of the rivals, 0.6 GB
# make bench-link                     round trips and ticks of a served robot (bench/link.py)
# make bench-async                    wall clock to a solved task on a served robot (bench/asynchronous.py)
# make bench-memory                   memory of the learner, full and over many epochs (bench/memory.py)
# make bench-journal                  what keeping every tick costs (bench/journal.py)
# make faults                         100 kills of learners, each checked (python -m tests.faults)
# make clean                          remove the environment, builds and caches; never runs/

TASK ?= push
ARGS ?=
# The first Python on the path that fits; PYTHON=/path/to/python overrides.
FITS := import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))
PYTHON ?= $(shell for p in python3 python3.12 python3.11; do \
	"$$p" -c '$(FITS)' 2>/dev/null && { echo "$$p"; exit; }; done; echo python3)

BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check -q
INSTALL := $(PIP) install -c constraints.txt --build-constraint constraints.txt

.PHONY: train install test test-full test-ray check bench bench-sbx bench-link bench-async bench-memory bench-journal \
	faults format clean

train: .venv/runtime
	$(BIN)/iher-robot train --driver mujoco --task $(TASK) $(ARGS)

install: .venv/runtime

# One thread a worker: two workers whose torch also takes both cores slow each other down. Tests of
# robots in real time mostly wait, and run apart from those that take all of a core, three at a time;
# a file of them shares its host, and the longest files come first in the order of folders. 5 says that
# ARGS selects none of a part.
test: .venv/dev
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 --dist worksteal -m "not real_time" $(ARGS) || [ $$? -eq 5 ]
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 3 --dist loadfile --no-loadscope-reorder -m real_time $(ARGS) || [ $$? -eq 5 ]

test-full: export IHER_ROBOT_SEQUENCES := 10000
test-full: test

test-ray: .venv/ray
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest tests/experiments/test_ray.py $(ARGS)

check: .venv/dev
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/lint-imports

bench: .venv/dev
	OMP_NUM_THREADS=1 $(BIN)/python -m bench.speed $(ARGS)

bench-sbx: .venv/dev
	$(INSTALL) -e '.[bench-sbx]'

bench-link: .venv/dev
	$(BIN)/python bench/link.py $(ARGS)

bench-async: .venv/dev
	OMP_NUM_THREADS=1 $(BIN)/python bench/asynchronous.py $(ARGS)

bench-memory: .venv/dev
	OMP_NUM_THREADS=1 $(BIN)/python bench/memory.py $(ARGS)

bench-journal: .venv/dev
	OMP_NUM_THREADS=1 $(BIN)/python bench/journal.py $(ARGS)

faults: .venv/dev
	IHER_ROBOT_MUTATIONS=1000 OMP_NUM_THREADS=1 $(BIN)/python -m pytest -n 2 tests/storage/test_mutations.py
	$(BIN)/python -m tests.faults $(ARGS)

format: .venv/dev
	$(BIN)/ruff format .
	$(BIN)/ruff check --fix .

.venv/base: constraints.txt
	@$(PYTHON) -c '$(FITS)' 2>/dev/null || { \
		echo "iher-robot needs Python 3.11 or 3.12, and $(PYTHON) is" \
			"$$($(PYTHON) --version 2>&1 || true);" \
			"install one of them and say: make PYTHON=/path/to/python3.12 ..." >&2; exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP) install $$(grep -E '^(pip|setuptools|wheel|packaging)==' constraints.txt)
	@touch $@

.venv/runtime: .venv/base pyproject.toml
	@echo "Installing into .venv; the first time this downloads torch and MuJoCo, 1 GB or more."
	$(INSTALL) -e .
	@touch $@

.venv/dev: .venv/runtime
	$(INSTALL) -e '.[dev,bench,data,report,sweep,video]'
	@touch $@

.venv/ray: .venv/dev
	$(INSTALL) -e '.[ray]'
	@touch $@

clean:
	rm -rf .venv build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -not -path './.git/*' -prune -exec rm -rf {} +
