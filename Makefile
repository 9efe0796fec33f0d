# Two commands on a fresh machine: `make demo` and `make test` (needs python3.11 and make, nothing else).
PYTHON ?= python3.11
VENV ?= .venv
WORKERS ?= 2
DEMO_DIR ?= runs/demo

BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
DEVICE_TESTS := tests/perception/sources tests/perception/looking/test_rerun_log.py tests/policies/report/test_flight_log.py \
	tests/policies/train/test_flight_callback.py tests/policies/watch/test_page.py
# One thread a process: the tests and the workers bring their own parallelism.
ONE_THREAD := OMP_NUM_THREADS=1 NUMBA_NUM_THREADS=1

.DEFAULT_GOAL := help
.PHONY: help install demo test test-slow test-clients test-lowest test-device test-ray docs notebooks lint bench clean

help:
	@echo "make demo       the shipped policy climbs on what its camera sees; writes a video"
	@echo "make test       the test suite (make test-slow: training and soak tests)"
	@echo "make test-clients  the recipes of examples/clients with the libraries that they are for"
	@echo "make test-lowest   core tests with the lowest versions that pyproject.toml allows"
	@echo "make test-device  devices, ROS recordings, Rerun and the page: installs these extras, and runs their tests"
	@echo "make test-ray    Ray and RLlib, on a cluster of three nodes on this machine that loses one"
	@echo "make docs       the documentation as a site in build/site, clicked through in a browser where Debian's chromium is"
	@echo "make notebooks  runs examples/notebooks from top to bottom, and keeps what they show"
	@echo "make lint       ruff and mypy"
	@echo "make bench      time ratios against bare PyBullet and naive chains"
	@echo "make install    only the virtual environment $(VENV)"

$(STAMP): pyproject.toml constraints.txt
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) not found: install it or pass PYTHON=..." >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev]'
	@touch $@

install: $(STAMP)

demo: $(STAMP)
	$(BIN)/stair-env demo --output $(DEMO_DIR)

test: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m pytest -n $(WORKERS) --dist loadfile -q tests

test-slow: $(STAMP)
	$(ONE_THREAD) $(BIN)/python -m pytest -m slow -q tests

# Environments of their own: these libraries, and these versions, are not those of the project. Of our constraints the
# clients leave out filelock, of which Tianshou's virtualenv wants an older one. RLlib asks for one version of Gymnasium,
# so it has an environment for itself; what stands in a .no-deps file asks for versions older than ours, and runs with ours.
SHARED_CLIENTS := $(filter-out examples/clients/rllib_%,$(wildcard examples/clients/*.txt))
test-clients:
	$(PYTHON) -m venv .venv-clients
	grep -v '^filelock==' constraints.txt > .venv-clients/constraints.txt
	.venv-clients/bin/python -m pip install --quiet -c .venv-clients/constraints.txt -e '.[all]' $(SHARED_CLIENTS:%=-r %)
	.venv-clients/bin/python -m pip install --quiet --no-deps $(patsubst %,-r %,$(wildcard examples/clients/*.no-deps))
	$(PYTHON) -m venv .venv-clients-rllib
	grep '^torch==' constraints.txt > .venv-clients-rllib/constraints.txt
	.venv-clients-rllib/bin/python -m pip install --quiet -c .venv-clients-rllib/constraints.txt -e . -r examples/clients/rllib_ppo.txt
	$(ONE_THREAD) .venv-clients/bin/python -W ignore examples/clients/run_all.py results/clients.md

LOWEST_TESTS := tests/stair_env/test_env.py tests/stair_env/test_vector.py tests/policies/test_pretrained.py tests/perception/test_wrapper.py
test-lowest:
	$(PYTHON) -m venv .venv-lowest
	.venv-lowest/bin/python -m pip install --quiet -c lowest.txt -e '.[all]' pytest hypothesis
	$(ONE_THREAD) .venv-lowest/bin/python -m pytest -q $(LOWEST_TESTS)
# The extras of a real camera and of looking at what it sees. pyrealsense2's wheel also needs Debian's libusb-1.0-0, the
# page's test Debian's chromium; without them these tests are skipped.
test-device: $(VENV)/.device
	$(ONE_THREAD) $(BIN)/python -m pytest -q -rs $(DEVICE_TESTS)

$(VENV)/.device: $(STAMP)
	$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[dev,realsense,ros,exr,rerun,watch]' playwright
	@touch $@

# RLlib asks for one version of Gymnasium, so it has an environment for itself; the other versions are ours.
RAY_TESTS := tests/stair_env/common/tasks tests/policies/train/rllib tests/perception/inference/test_frame_server.py
test-ray:
	$(PYTHON) -m venv .venv-ray
	grep -v '^gymnasium==' constraints.txt > .venv-ray/constraints.txt
	.venv-ray/bin/python -m pip install --quiet -c .venv-ray/constraints.txt -e '.[dev,ray]'
	$(ONE_THREAD) .venv-ray/bin/python -m pytest -q -rs -m 'slow or not slow' $(RAY_TESTS)

# An environment of its own: what builds pages is no part of what runs. The last line is skipped where no browser is.
docs:
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet -c constraints.txt -e '.[docs]' pytest hypothesis
	$(ONE_THREAD) DISABLE_MKDOCS_2_WARNING=true NO_MKDOCS_2_WARNING=1 .venv-docs/bin/python -m mkdocs build --quiet --strict
	.venv-docs/bin/python -m pytest -q -rs -m slow tests/test_site.py

notebooks:
	$(PYTHON) -m venv .venv-docs
	.venv-docs/bin/python -m pip install --quiet -c constraints.txt -e '.[docs,rerun]' nbconvert ipykernel
	cd examples/notebooks && $(ONE_THREAD) ../../.venv-docs/bin/python -m nbconvert --to notebook --execute --inplace *.ipynb

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

bench: $(STAMP)
	$(BIN)/stair-env bench

clean:
	rm -rf $(VENV) .venv-clients .venv-clients-rllib .venv-lowest .venv-ray runs build dist *.egg-info .pytest_cache .mypy_cache .ruff_cache
