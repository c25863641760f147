# Needs make and Python 3.11 or newer; everything else goes into .venv.
# PYTHON=/path/to/python chooses the interpreter .venv is made from.

.DEFAULT_GOAL := help
.PHONY: help setup demo live docs site gallery stories test slowest lint format prove fuzz fuzz-guided soak rough pairs trial judge bench bench-check fleet-scale dist size audit clean clean-cache

BIN := $(if $(filter Windows_NT,$(OS)),.venv/Scripts,.venv/bin)
# Of `make trial`: which suites, how many explanations at a time; SEED=N repeats a trial, and
# AGAINST=../older/.venv/bin/handcal has another version explain the same recordings.
SUITES := nothing one mixed unknown turn faint reference large phone odometry people budget wild strange axis walks ordinary
JOBS := 1
SEED :=
AGAINST :=
# (pip would compile all that is never used, too: 100 MB)
PIP := $(BIN)/python -m pip install --disable-pip-version-check --quiet --no-compile -c constraints.txt
PYTHONS := $(PYTHON) python3 python3.13 python3.12 python3.11 python3.14 python

help: ## list these targets
	@sed -n 's/^\([a-z-]*\):.*## /  make \1\t/p' Makefile | expand -t 20

setup: .venv/.installed ## make .venv and .venv/bin/handcal
	@echo "Ready: .venv/bin/handcal --help"

demo: setup ## simulate a recording, calibrate and explain it, write reports and data
	$(BIN)/handcal demo

live: .venv/.installed-live ## install what serves the page of `handcal live` to a phone

docs: .venv/.installed-dev ## write the catalogue and draw the figures of docs/ anew
	$(BIN)/python docs/make_effects.py
	$(BIN)/python docs/make_formats.py
	$(BIN)/python docs/make_layers.py
	$(BIN)/python docs/make_use.py
	$(BIN)/python docs/make_licences.py
	$(BIN)/python docs/make_results.py
	$(BIN)/python docs/make_notebook.py
	$(BIN)/python docs/make_figures.py
	$(BIN)/python docs/make_trust_figure.py
	$(BIN)/python docs/make_explain_figures.py
	$(BIN)/python docs/make_sweep_figures.py
	$(BIN)/handcal design poses --n 12 --seed 0 --picture docs/images/poses.png
	$(BIN)/python docs/make_paper_tables.py

site: .venv/.installed-docs ## the documentation, to be read from the disk: site/index.html
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict
	@echo "Ready: site/index.html"

gallery: .venv/.installed ## explain the real recordings beside the checkout, write docs/gallery/: an hour
	$(BIN)/python docs/make_gallery.py

stories: .venv/.installed-dev ## tell docs/stories.md anew: ten minutes
	cd docs && ../$(BIN)/python make_stories.py

test: lint ## all quick checks and tests
	$(BIN)/python -m pytest -n auto --dist loadfile -m "not prove"

slowest: .venv/.installed-dev ## the hundred slowest of the quick tests, and what each proves
	$(BIN)/python scripts/slowest.py

prove: .venv/.installed-dev .venv/.installed-docs ## the slow statistics, with their tables
	$(BIN)/python -m pytest -m prove -s

fuzz: .venv/.installed-dev ## mutated files of every format: N=100000 SEED=0; failures go to fuzz-out/
	$(BIN)/python tests/fuzz.py --n $(or $(N),100000) --seed $(or $(SEED),0)

fuzz-guided: .venv/.installed-fuzz ## the same, led by coverage (atheris: Linux or macOS, Python 3.11 to 3.13)
	$(BIN)/python tests/fuzz_guided.py --n $(or $(N),100000) --seed $(or $(SEED),0)

soak: .venv/.installed-dev ## hours at 200 Hz (HOURS=2), a million violent steps, files cut at every byte
	SOAK_HOURS=$(or $(HOURS),2) $(BIN)/python -m pytest -m prove -s tests/test_soak.py tests/test_fuzz.py

rough: .venv/.installed-dev ## commands ended at random moments, eight processes that compile at once
	$(BIN)/python -m pytest -m prove -s tests/test_rough.py tests/test_disk_cache.py

pairs: .venv/.installed-dev ## two runs of a command at once into one folder: N=100 SEED=0
	$(BIN)/python tests/pairs.py --n $(or $(N),100) --seed $(or $(SEED),0)

trial: setup ## blind trials of explain at full size: hours; scores in trial-out/
	@mkdir -p trial-out
	@for s in $(SUITES); do \
	  $(BIN)/handcal prove --suite $$s --jobs $(JOBS) $(if $(SEED),--seed $(SEED)) \
	    $(if $(AGAINST),--against $(AGAINST)) --json trial-out/$$s.json || exit; \
	done

judge: .venv/.installed-dev ## 120 recordings explained, into judge-out/: hours; QUICK=1 a part, RESUME=1, AGAINST=TABLE, SEED=N, JOBS=2
	$(BIN)/python benchmarks/judge.py --jobs $(JOBS) $(if $(QUICK),--quick) $(if $(RESUME),--resume) \
	  $(if $(SEED),--seed $(SEED)) $(if $(AGAINST),--against $(AGAINST))

bench: .venv/.installed-bench ## speed beside other programs, start-up, memory, docs/profiles.md: 22 minutes, and 2 for each real recording
	@mkdir -p bench-out
	$(BIN)/handcal bench --all --json bench-out/bench.json
	$(BIN)/python docs/make_profiles.py bench-out/bench.json

bench-check: .venv/.installed-bench ## fail where a ratio to other programs is 30 % worse than kept
	$(BIN)/handcal bench --rounds 7 --only filter --only filterpy --only gtsam --only epochs \
	  --against benchmarks/ratios.json

fleet-scale: setup ## what a fleet costs beside its explanations (N=1000 stand-ins): processor time, memory, bytes
	$(BIN)/python scripts/fleet_scale.py --recordings $(or $(N),1000) $(if $(DASK),--executor dask)

dist: .venv/.installed-dev ## source archive, wheel and bill of materials (CycloneDX) in dist/
	@rm -rf dist
	@echo "Compiling for what most machines can do, which takes a minute."
	$(BIN)/python scripts/compile.py --ship
	$(BIN)/python -m hatchling build; made=$$?; rm -rf src/handcal/compiled/shipped; exit $$made
	$(PIP) --no-deps -e .
	$(BIN)/python scripts/sbom.py dist

size: ## megabytes by package in a new environment, as installed: needs a package index
	@rm -rf build/size && $(or $(PYTHON),python3) -m venv build/size
	@build/size/bin/python -m pip install --disable-pip-version-check --quiet --no-compile .
	@build/size/bin/python scripts/size.py --most 550
	@rm -rf build/size

audit: .venv/.installed-audit ## ask for known vulnerabilities of the pinned versions: needs a network
	@$(BIN)/python scripts/audit.py

lint: .venv/.installed-dev ## style, types and the direction of imports
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(BIN)/lint-imports --no-logo

format: .venv/.installed-dev ## put the code into the project's format
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

clean: ## remove .venv, caches, builds, the demo's output and scores of trials
	rm -rf .venv .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
	rm -rf build dist site demo-out trial-out bench-out fuzz-out gallery-out judge-out
	find src sim tests -name __pycache__ -prune -exec rm -rf {} +

clean-cache: ## remove compiled kernels (do so after editing what is compiled into others)
	find src tests \( -name "*.nb[ci]" -o -name "*.busy" \) -delete

# The stamps below are touched last, so that a step that broke off is done again.

.venv/.created:
	@for p in $(PYTHONS); do \
	  if "$$p" -c 'import ensurepip, sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then \
	    echo "Making .venv with $$("$$p" --version)."; \
	    "$$p" -m venv --clear .venv && touch $@; exit; \
	  fi; \
	done; \
	echo "handcal needs Python 3.11 or newer with venv and pip; none was found (make PYTHON=/path/to/python names one)." >&2; \
	exit 1

.venv/.installed: .venv/.created pyproject.toml constraints.txt
	@echo "Installing handcal into .venv; the first time this takes a minute or two."
	@$(PIP) -e .
	@echo "Compiling the filter, which takes half a minute."
	@$(BIN)/python scripts/compile.py
	@touch $@

.venv/.installed-dev: .venv/.installed
	@echo "Installing the tools for the tests into .venv."
	@$(PIP) -e ".[dev]"
	@touch $@

.venv/.installed-docs: .venv/.installed
	@echo "Installing the tools for the documentation site into .venv."
	@$(PIP) -e ".[docs]"
	@touch $@

.venv/.installed-live: .venv/.installed
	@echo "Installing the page's server into .venv."
	@$(PIP) -e ".[live]"
	@touch $@
	@echo "Ready: .venv/bin/handcal live --lan"

.venv/.installed-bench: .venv/.installed
	@echo "Installing what handcal is measured against into .venv."
	@$(PIP) -e ".[bench]"
	@touch $@

.venv/.installed-audit: .venv/.installed
	@echo "Installing pip-audit into .venv."
	@$(PIP) -e ".[audit]"
	@touch $@

.venv/.installed-fuzz: .venv/.installed-dev
	@echo "Installing atheris into .venv."
	@$(PIP) -e ".[fuzz]"
	@touch $@
