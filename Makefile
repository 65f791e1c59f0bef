# Everything here works on a fresh machine with Python (3.11 or later) and make; nothing is installed outside .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/installed

.PHONY: demo test lint fmus wheel study bench conformance platforms clean

demo: fmus
	$(BIN)/cosim run studies/shams2010/fsmc_5sin.toml --plot build/demo/fsmc_5sin.png --output build/demo/fsmc_5sin.csv

test: $(INSTALLED)
	$(BIN)/python -m pytest

lint: $(INSTALLED)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright

fmus: $(INSTALLED)
	$(BIN)/python build_fmus.py

# wheel with the FMUs of all platforms, and sdist; the first compilation for Windows takes minutes
wheel: $(INSTALLED)
	$(BIN)/python build_fmus.py --platform all --output build/fmus/release
	$(BIN)/hatchling build --directory build/dist

study: fmus
	for name in $(notdir $(wildcard studies/*)); do \
		$(BIN)/cosim study $$name --output build/studies/$$name || exit 1; done

bench: fmus
	$(BIN)/python -m pip install --quiet --editable ".[bench]"
	for script in $(filter-out benchmarks/peers.py benchmarks/same_results.py,$(wildcard benchmarks/*.py)); do $(BIN)/python $$script || exit 1; done

# other importers, in venvs of their own; writes docs/importers.md (ecospy needs libtbb.so.12, Debian's libtbb12).
# Programs built elsewhere: make conformance PROGRAMS="--fmusim PATH --fmu-check PATH --omsimulator PATH"
conformance: $(INSTALLED)
	$(BIN)/python build_fmus.py --flavour both
	$(BIN)/python build_fmus.py --fmi 3
	for name in importers importers-cofmupy; do \
		test -x build/$$name/bin/python || $(PYTHON) -m venv build/$$name || exit 1; \
		grep -v '^#' tests/importers/requirements$${name#importers}.txt | \
			xargs -n 1 build/$$name/bin/python -m pip install --quiet || \
			echo "Not every importer could be installed; the page says which."; \
	done
	$(BIN)/python -m tests.importers.conform --python build/importers/bin/python \
		--cofmupy build/importers-cofmupy/bin/python $(PROGRAMS)
	$(BIN)/python -m pytest tests/importers/follow.py

# win64 under wine, aarch64-linux under qemu (Debian: wine, qemu-user, libc6-arm64-cross)
platforms: $(INSTALLED)
	$(BIN)/python -m pytest tests/importers/platforms.py tests/importers/binaries.py -rs

clean:
	rm -rf build .pytest_cache .ruff_cache .hypothesis

# reinstalled only when pyproject.toml changes
$(INSTALLED): pyproject.toml
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --editable ".[build,importers,test]"
	touch $(INSTALLED)
