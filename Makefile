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
# make clients: our files in Blender, three.js, OpenSim, OpenUSD and glTF's validator (1 GB of them),
# and the page in Chromium where there is one.
# make bench: those result files themselves (needs RECON_DATA; many hours).
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --constraint constraints.txt
CI := $(BIN)/python -m scripts.ci
OUT ?= out
BASE ?= origin/main

.PHONY: demo test test-slow frozen frozen-reference figures changelog dist docs mutants tables clients bench clean

demo: .venv/installed
	$(CI) demo

test: .venv/developed
	$(CI) lint types test

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

clients: .venv/developed
	$(PIP) --editable '.[usd]'
	$(PYTHON) -m venv $(OUT)/clients/opensim
	$(OUT)/clients/opensim/bin/pip install --quiet opensim==4.6 usd-core==26.11
	$(PYTHON) -m venv $(OUT)/clients/blender
	$(OUT)/clients/blender/bin/pip install --quiet bpy==5.0.1
	npm install --silent --prefix $(OUT)/clients/node three@0.187.0 gltf-validator@2.0.0-dev.3.10 \
		@pixiv/three-vrm@3.5.5 @pixiv/three-vrm-animation@3.5.5
	$(BIN)/python -m benchmarks.clients --python $(OUT)/clients/opensim/bin/python \
		--blender $(OUT)/clients/blender/bin/python --node $(OUT)/clients/node/node_modules \
		--out benchmarks/results
	$(BIN)/pytest -q -rs tests/view/test_page.py

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
