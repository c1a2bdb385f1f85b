# SPDX-License-Identifier: GPL-3.0-or-later
# make demo        model, bake, render and export the kindergarten scene into build/demo
# make test        run all tests                       (TESTS=tests/solver runs some)
# make fuzz        bake random scenes for two hours   (TACTILE_CLAY_FUZZ_MINUTES=10 for less)
# make bench       measure speed into build/bench
# make bench-peers measure other engines beside it, in environments of their own in build/peers
# make acoustic-peers  try fields and drives against levitate and autd3, in environments likewise
# make array-peers install AUTD3's own packages for the tests of that device, into build/peers
# make report      run the physics experiments into build/report
# make extension   build the extension's zips and their index into dist (PLATFORMS=linux-x64 builds one)
# make lint        check style and types
# make clean       delete all that was built, and the environment
#
# Each makes the Python environment first, if it does not stand. PYTHON=/path/to/python chooses the
# Python (3.13 or 3.11), VENV=name the environment's folder.

VENV ?= .venv
PYTHON ?=
TESTS ?= tests
PLATFORMS ?=
TACTILE_CLAY_FUZZ_MINUTES ?= 120

# A person's own Python settings must not reach into the environment.
unexport PYTHONPATH PYTHONHOME PYTHONSTARTUP
export PYTHONNOUSERSITE = 1

python = $(VENV)/bin/python
# A file's tests stay together, so that what they share is made once.
workers = --numprocesses auto --maxprocesses 4 --dist loadfile

.PHONY: demo test fuzz bench bench-peers acoustic-peers array-peers report extension lint format environment clean
.DEFAULT_GOAL = demo

environment:
	@PYTHON='$(PYTHON)' tools/environment.sh '$(VENV)'

demo: environment
	@$(VENV)/bin/tactile-clay demo --output build/demo

test: environment
	@$(python) -m pytest $(workers) $(TESTS)

fuzz: environment
	@TACTILE_CLAY_FUZZ_MINUTES='$(TACTILE_CLAY_FUZZ_MINUTES)' $(python) -m pytest -s \
		tests/reports/test_fuzzed_scenes.py

bench: environment
	@$(python) -m tactile_clay.tests.bench.run --output build/bench

bench-peers: environment
	@$(python) -m tactile_clay.tests.bench.peers --output build/bench

acoustic-peers: environment
	@$(python) -m tactile_clay.tests.haptics.peers.environments
	@$(python) -m pytest -s tests/haptics/peers

array-peers: environment
	@$(python) -m tactile_clay.tests.haptics.peers.autd3_environment

report: environment
	@$(python) -m tactile_clay.tests.experiments.report --output build/report

extension: environment
	@$(python) tools/extension.py --output dist $(if $(PLATFORMS),--platforms $(PLATFORMS))

lint: environment
	@$(python) tools/lint.py

format: environment
	@$(python) -m ruff check --fix --quiet .
	@$(python) -m ruff format --quiet .

clean:
	rm -rf build dist wheels .venv .venv-* *.egg-info .pytest_cache .ruff_cache .mypy_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
