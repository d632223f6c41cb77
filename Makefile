# make demo: reconstruct the bundled noisy clip.   make test: lint, types, tests.
# make test-slow: the tests marked slow, run before a release.
# make figures: how large the project is; fails when a figure is above its ceiling.
# make changelog: fails when commits since BASE (origin/main) ask for a line that is not there.
# make mutants: small faults in some modules, and which of them their tests notice.
# make frozen-reference, make frozen: what short fits, verbs and exporters give now, kept in $(OUT)/frozen,
# and whether they still give it (four minutes each).
# make dist: wheel and sdist in dist/, tried in empty environments of Python 3.11 to 3.13.
# make docs: the documentation site, in site/.
# make tables: the tables of README.md and docs/ from benchmarks/results.
# make bench: those result files themselves (needs RECON_DATA; many hours).
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --constraint constraints.txt
CI := $(BIN)/python -m scripts.ci
OUT ?= out
BASE ?= origin/main

.PHONY: demo test test-slow frozen frozen-reference figures changelog dist docs mutants tables bench clean

demo: .venv/installed
	$(CI) demo

test: .venv/developed
	$(CI) lint types test numerics

test-slow: .venv/developed
	$(CI) slow

figures: .venv/developed
	$(CI) figures

frozen-reference: .venv/developed
	$(BIN)/python -m scripts.frozen --out $(OUT)/frozen

frozen: .venv/developed
	$(BIN)/python -m scripts.frozen --against $(OUT)/frozen

dist: .venv/developed
	$(CI) dist

docs: .venv/developed
	$(CI) docs

changelog: .venv/developed
	$(CI) changelog --base $(BASE)

mutants: .venv/developed
	$(BIN)/python -m benchmarks.mutants --out benchmarks/results

tables: .venv/developed
	$(BIN)/python -m benchmarks.tables

bench: .venv/developed
	mkdir -p $(OUT)
	$(BIN)/python -m benchmarks.all --out $(OUT)

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(CI) install
	touch $@

.venv/developed: .venv/installed
	$(CI) develop
	touch $@

clean:
	rm -rf .venv demo site $(OUT)
