# setup: a virtual environment with everything; check: format, lint, types; test: the tests of every day.
# Set VENV to use another environment.
VENV ?= .venv
PYTHON ?= python3
BIN := $(VENV)/bin

.PHONY: setup check test test-all bench bench-edits bench-speed first-user samples paper demo report-script clean

setup: $(BIN)/conflank

$(BIN)/conflank: pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --editable ".[dev]"
	touch $@

check: setup
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy

test: setup
	$(BIN)/python -m pytest -n auto --dist worksteal

test-all: setup
	$(BIN)/python -m pytest -n auto --dist worksteal -m "slow or not slow"

bench: setup
	$(BIN)/python -m benchmarks.run
	$(BIN)/python -m benchmarks.detection
	$(BIN)/python -m benchmarks.optimization --json benchmarks/results/optimization.json
	$(BIN)/python -m benchmarks.certificate
	$(BIN)/python -m benchmarks.selection
	$(BIN)/python -m benchmarks.passes
	$(BIN)/python -m benchmarks.posting
	$(BIN)/python -m benchmarks.posts
	$(BIN)/python -m benchmarks.collision --json benchmarks/results/collision.json
	$(BIN)/python -m benchmarks.dnc

# Edits of posted programs, single and systematic: how many the verification finds. Some twenty minutes of one core.
bench-edits: setup
	$(BIN)/python -m benchmarks.edits

# The README in an empty folder, every command as it is printed: from nothing to a report, and its time.
first-user: setup
	$(BIN)/python -m benchmarks.first_user --json benchmarks/results/first_user.json

# How fast everything is; rewrites docs/speed.md with its pictures. A machine with nothing else to do makes better figures.
bench-speed: setup
	$(BIN)/python -m benchmarks.speed --json benchmarks/results/speed.json

# Everything in the repository that is made and not written: the sample parts (equal formulas give equal bytes), what the
# tour's commands print, among them the main job, then pictures and tables. Review the changes and commit them.
# The other jobs of the sample parts are in sample_parts/Makefile, the rows of the bench come from
# `python -m benchmarks.run --json benchmarks/results/bench.json`.
samples: setup
	$(MAKE) -B -C sample_parts parts CONFLANK=$(abspath $(BIN)/conflank) PYTHON=$(abspath $(BIN)/python)
	$(BIN)/python -m docs.tour
	$(BIN)/python -m docs.pictures out
	$(BIN)/python -m benchmarks.knot_spacing --json benchmarks/results/knot_spacing.json
	$(BIN)/python -m benchmarks.readme --sample out/BLISK1.H.verification.json

# The paper's experiments: docs/paper.md with its tables and pictures, some ten minutes on two quiet cores. ONLY=sample leaves
# out the real blades. Exit code 1 says that one of the paper's figures is missed; the page then says which.
paper: setup
	$(BIN)/python -m benchmarks.paper $(if $(ONLY),--only $(ONLY)) || test $$? -eq 1
	$(BIN)/python -m benchmarks.readme

# The main job: from the STEP file of a blade to a program that has been read back and measured. Findings (exit code 1)
# are a result of it, not a failure of the demonstration.
demo: setup
	$(BIN)/conflank run sample_parts/blisk_blade/job.toml --out out || test $$? -eq 1

# The script of the report, from its sources and three.js, into one file that is in the repository; needs Node.js.
# Conflank itself needs neither.
report-script:
	cd conflank_cli/report/web && npm ci --ignore-scripts --no-audit --no-fund && npm run build

clean:
	rm -rf out .pytest_cache .mypy_cache .ruff_cache .hypothesis
