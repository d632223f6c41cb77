# make demo: reconstruct the bundled noisy clip.   make test: lint, types, tests.
# make bench: every table of the README (needs RECON_DATA).
PYTHON ?= python3
BIN := .venv/bin
STAMP := .venv/.installed
OUT ?= out

.PHONY: demo test bench clean

demo: $(STAMP)
	$(BIN)/recon demo --out demo

test: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright
	$(BIN)/lint-imports
	$(BIN)/pytest -q -n 2 --dist loadfile

bench: $(STAMP)
	mkdir -p $(OUT)
	$(BIN)/python -m benchmarks.all --out $(OUT)

$(STAMP): pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --upgrade 'pip>=25.1'
	$(BIN)/pip install --quiet --constraint constraints.txt --editable . --group dev
	touch $@

clean:
	rm -rf .venv demo $(OUT)
