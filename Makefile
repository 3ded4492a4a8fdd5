# make demo        the main job on the built-in world: tables, figures and logs in demo/
# make test        lint, types and the test suite
# make test-long   the same with the tests that take minutes
# make test-numba  the tests of what Numba compiles, with the lowest and the highest supported versions
# make bench       every script of benchmarks/: tables and figures in benchmarks/results/
# make lint        lint and types alone
# make clean       removes the environment and everything that was built
#
# Each sets up the environment .venv first where that is needed. PYTHON=/path/to/python3.12 chooses the interpreter.

.PHONY: demo test test-long test-numba bench lint clean

bin := .venv/bin
ready := .venv/ready
benchmarks := $(filter-out benchmarks/_%,$(wildcard benchmarks/*.py))
numba_tests := $(wildcard tests/compiled tests/belief tests/filters tests/models tests/fuzz)

# The Pythons of test-numba: versions, names or paths. uv looks for a version on PATH, and downloads it where it is not.
PYTHONS := 3.11 3.14

demo: $(ready)
	$(bin)/slamkit demo --out demo

test: lint
	$(bin)/python -m pytest -n auto --dist worksteal

test-long: lint
	$(bin)/python -m pytest -n auto --dist worksteal -m "slow or not slow"

# The first Python gets the lowest versions of all direct dependencies, and the last one the highest. Each environment
# stays in a folder .venv-numba-*, and is brought up to date by the next run.
test-numba: $(ready)
	@$(bin)/python -m pip install --quiet --disable-pip-version-check --editable '.[release]'
	@set -e; test_with() { \
		environment=".venv-numba-$$1-$$(basename "$$2")"; \
		"$$environment/bin/python" -c '' 2>/dev/null || $(bin)/uv venv --quiet --clear --python "$$2" "$$environment"; \
		$(bin)/uv pip install --quiet --upgrade --python "$$environment/bin/python" --resolution "$$1" --editable '.[test]'; \
		"$$environment/bin/python" -c 'import platform, numba, numpy; print("Python", platform.python_version(), "Numba", numba.__version__, "NumPy", numpy.__version__)'; \
		"$$environment/bin/python" -m pytest -n auto --dist worksteal $(numba_tests); \
	}; \
	test_with lowest-direct "$(firstword $(PYTHONS))"; \
	test_with highest "$(lastword $(PYTHONS))"

# GTSAM is not there for every Python; MRPT is no Python package (on Debian: apt install libmrpt-slam-dev).
bench: $(ready)
	@$(bin)/python -c 'import gtsam' 2>/dev/null || \
	$(bin)/python -m pip install --quiet --disable-pip-version-check --editable '.[bench]' || \
	echo "GTSAM cannot be installed here: iSAM2 takes no part." >&2
	@set -e; for script in $(benchmarks); do echo "$$script"; $(bin)/python "$$script"; done

lint: $(ready)
	$(bin)/ruff check
	$(bin)/ruff format --check
	$(bin)/mypy
	MYPYPATH=typings $(bin)/stubtest filterpy.kalman --ignore-missing-stub --concise

clean:
	rm -rf .venv .venv-numba-* build dist demo slamkit.egg-info .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find slamkit models tests tutorials benchmarks -name __pycache__ -type d -prune -exec rm -rf {} +

# A candidate must be new enough and able to make an environment with pip: a system's python3 may lack ensurepip.
$(ready): setup.cfg pyproject.toml
	@$(bin)/python -m pip --version >/dev/null 2>&1 || { \
	for python in $(if $(PYTHON),"$(PYTHON)",python3 python3.14 python3.13 python3.12 python3.11); do \
		"$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 || continue; \
		"$$python" -m venv --clear .venv >/dev/null 2>&1 && exit 0; \
		rm -rf .venv; \
		echo "$$python cannot make a virtual environment (on Debian and Ubuntu: apt install python3-venv)" >&2; \
	done; \
	echo "slamkit needs Python 3.11 or newer with venv and pip, and found none as $(or $(PYTHON),python3 or python3.11 to python3.14 on PATH)." >&2; \
	echo "Install one, or name it: make PYTHON=/path/to/python3" >&2; \
	exit 1; }
	@echo "Installing slamkit and its tools into .venv; the first time takes a minute or two."
	@$(bin)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@
