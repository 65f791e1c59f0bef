# Everything here works on a machine with Python (3.11 or later) and make; nothing is installed outside .venv.
# Another Python than python3: make PYTHON=python3.12 demo
VENV := .venv
BIN := $(VENV)/bin
export PYTHON CONSTRAINTS
# those of another Python would stop .venv's, or hide its packages
unexport PYTHONHOME PYTHONPATH

.PHONY: demo test lint fmus wheel release study bench docs conformance platforms lowest constraints clean build-tools \
	test-tools lint-tools docs-tools

demo: fmus
	$(BIN)/cosim run studies/shams2010/fsmc_5sin.toml --plot build/demo/fsmc_5sin.png --output build/demo/fsmc_5sin.csv

test: test-tools
	$(BIN)/python -m pytest

lint: lint-tools
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pyright
	$(BIN)/pyright --project tests/pyrightconfig.json
	$(BIN)/clang-format --dry-run --Werror $$(find src/cosim/export tests benchmarks -name '*.[ch]')
	$(BIN)/python -m tests.tidy

fmus: build-tools
	$(BIN)/python build_fmus.py

# wheel with the FMUs of all platforms, and sdist; the first compilation for Windows takes minutes
wheel: build-tools
	$(BIN)/python build_fmus.py --platform all --output build/fmus/release
	$(BIN)/hatchling build --directory build/dist

# build/release: wheel, sdist, site, bill of materials, SHA256SUMS; the same commit gives the same bytes
release: export CONSTRAINTS := constraints.txt
release:
	@sh .ci/venv build docs plots release test
	$(BIN)/python .ci/release.py check
	$(MAKE) wheel
	$(BIN)/python build_fmus.py
	$(BIN)/python -m docs.build
	$(BIN)/python .ci/release.py collect

# the documentation as a site, build/site/html/index.html: its tutorials and examples run while it is built
docs: docs-tools fmus
	$(BIN)/python -m docs.build
	$(BIN)/python -m pytest tests/docs/built_site.py

study: test-tools fmus
	for name in $(notdir $(wildcard studies/*)); do \
		$(BIN)/cosim study $$name --output build/studies/$$name || exit 1; done

# modules of the benchmarks, and programs with arguments or another Python
NO_BENCHMARK := equal_traces figures fit_mujoco peers programs same_results

bench: test-tools fmus
	sh .ci/venv bench
	for script in $(filter-out $(NO_BENCHMARK:%=benchmarks/%.py),$(wildcard benchmarks/*.py)); do \
		$(BIN)/python $$script || exit 1; done

# other importers, in venvs of their own; writes docs/importers.md (ecospy needs libtbb.so.12, Debian's libtbb12).
# Programs built elsewhere: make conformance PROGRAMS="--fmusim PATH --fmu-check PATH --omsimulator PATH"
conformance: test-tools
	$(BIN)/python build_fmus.py --flavour both
	$(BIN)/python build_fmus.py --fmi 3
	for name in importers importers-cofmupy; do \
		test -x build/$$name/bin/pip || $(BIN)/python -m venv build/$$name || exit 1; \
		grep -v '^#' tests/importers/requirements$${name#importers}.txt | \
			xargs -n 1 build/$$name/bin/python -m pip install --quiet || \
			echo "Not every importer could be installed; the page says which."; \
	done
	$(BIN)/python -m tests.importers.conform --python build/importers/bin/python \
		--cofmupy build/importers-cofmupy/bin/python $(PROGRAMS)
	$(BIN)/python -m pytest tests/importers/follow.py

# win64 under wine, aarch64-linux under qemu (Debian: wine, qemu-user, libc6-arm64-cross)
platforms: test-tools
	$(BIN)/python -m pytest tests/importers/platforms.py tests/importers/binaries.py

# the oldest releases that pyproject.toml allows, in a venv of their own, under the core tests
lowest: build-tools
	$(BIN)/python .ci/lowest

# what CI installs: the newest releases that pyproject.toml allows today, from a venv of their own
constraints: build-tools
	rm -rf build/constraints
	$(BIN)/python -m venv build/constraints
	build/constraints/bin/python -m pip install --quiet --editable ".[build,docs,importers,lint,release,test]"
	echo "# Written by make constraints: what CI installs." > constraints.txt
	build/constraints/bin/python -m pip freeze --exclude-editable >> constraints.txt

clean:
	rm -rf build .pytest_cache .ruff_cache .hypothesis

# what make demo needs, and what the tests need beside it
build-tools:
	@sh .ci/venv build plots
test-tools:
	@sh .ci/venv build importers plots test
lint-tools:
	@sh .ci/venv build importers plots test lint
docs-tools:
	@sh .ci/venv build docs plots test
