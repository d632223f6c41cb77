# make demo: reconstruct the bundled noisy clip.   make test: lint, types, tests.
# make test-slow: the tests marked slow, run before a release.
# make mutants: small faults in some modules, and which of them their tests notice.
# make dist: wheel and sdist in dist/, tried in empty environments of Python 3.11 to 3.13.
# make docs: the documentation site, in site/.
# make tables: the tables of README.md and docs/ from benchmarks/results.
# make clients: our files in Blender, three.js, OpenSim, OpenUSD and glTF's validator (1 GB of them),
# and the page in Chromium where there is one.
# make bench: those result files themselves (needs RECON_DATA; many hours).
PYTHON ?= python3
BIN := .venv/bin
PIP := $(BIN)/pip install --quiet --constraint constraints.txt
OUT ?= out
# On the kernels of other processors, from inputs off by a few units in the last place. Shapes
# hang on neither, and were checked before.
NUMERICS = JAXTYPING_DISABLE=1 $(BIN)/pytest -q -n 2 --dist loadfile -m 'numerics and not slow' --ulps 4

.PHONY: demo test test-slow dist docs mutants tables clients bench clean

demo: .venv/installed
	$(BIN)/recon demo --out demo

test: .venv/developed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/pytest -q -n 2 --dist loadfile -m 'not slow'
	ATEN_CPU_CAPABILITY=default MKL_CBWR=COMPATIBLE $(NUMERICS)

test-slow: .venv/developed
	$(BIN)/pytest -q -n 2 --dist loadfile -m slow
	ATEN_CPU_CAPABILITY=avx2 $(NUMERICS)

dist: .venv/developed
	$(BIN)/python -m scripts.distributions --out dist

docs: .venv/developed
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet

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
	npm install --silent --prefix $(OUT)/clients/node three@0.187.0 gltf-validator@2.0.0-dev.3.10
	$(BIN)/python -m benchmarks.clients --python $(OUT)/clients/opensim/bin/python \
		--blender $(OUT)/clients/blender/bin/python --node $(OUT)/clients/node/node_modules \
		--out benchmarks/results
	$(BIN)/pytest -q -rs tests/view/test_page.py

bench: .venv/developed
	mkdir -p $(OUT)
	$(BIN)/python -m benchmarks.all --out $(OUT)

.venv/installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade 'pip>=25.1'
	$(PIP) --editable .
	touch $@

.venv/developed: .venv/installed
	$(PIP) --group dev
	touch $@

clean:
	rm -rf .venv demo site $(OUT)
