# make demo   installs into .venv and runs the main job on the embedded pool
# make test   installs into .venv and runs the quick tests
# make help   lists the rest

PYTHON ?= python3
VENV ?= .venv
OUT ?= out/demo
RUN = $(VENV)/bin
PYTEST = $(RUN)/pytest -n auto --maxprocesses 4 --dist loadfile
# Most of a quick test's time is XLA's compiler; what runs once need not be optimised. test-all compiles as users do.
QUICKLY = XLA_FLAGS="$$XLA_FLAGS --xla_backend_optimization_level=0"
# Not the whole folder: what users make here (banks, with their cards) is not the project's.
CODE = cluttergen_jax tests studies docs examples scenes $(wildcard reports) $(wildcard *.py *.md)
INSTALL = $(RUN)/pip install --quiet --disable-pip-version-check -c constraints.txt

.DEFAULT_GOAL := help
.PHONY: help demo test test-all test-wheel lint dist reports docs images format scenes bench clean prerequisites

help: ## this list
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 14

prerequisites:
	@command -v git >/dev/null || { echo "git is missing: install it (Debian, Ubuntu: apt install git)"; exit 1; }
	@command -v $(PYTHON) >/dev/null || { echo "$(PYTHON) is missing: install Python 3.11 or newer"; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "$(PYTHON) is $$($(PYTHON) --version): Python 3.11 or newer is needed; make PYTHON=python3.11 demo"; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' 2>/dev/null || \
	  { echo "$(PYTHON) has no venv: install it (Debian, Ubuntu: apt install python3-venv)"; exit 1; }

$(VENV)/.core: pyproject.toml constraints.txt | prerequisites
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e .
	@touch $@

$(VENV)/.dev: $(VENV)/.core
	$(INSTALL) -e '.[dev,ycb,ray,robot,record,video,coco]'
	@touch $@

$(VENV)/.all: $(VENV)/.dev
	$(INSTALL) -e '.[dev,ycb,ray,robot,record,video,coco,peers,usd,viewer,browser,fuzz,hub,docs,remote,perception,photo,rerun,readers]'
	@touch $@

demo: $(VENV)/.core ## generate, draw, save and verify 20 scenes of ten dining objects in out/demo
	$(RUN)/cluttergen generate --pool dining --num-scenes 20 --out $(OUT)
	$(RUN)/cluttergen verify $(OUT)

test: lint ## lint, types and the quick tests
	$(QUICKLY) $(PYTEST) -m "not slow"

test-all: $(VENV)/.all ## every test, with the extras; writes tests/last_run.json
	$(PYTEST) --record tests/last_run.json

lint: $(VENV)/.dev ## ruff, mypy, undeclared dependencies and the import contracts alone
	$(RUN)/ruff check $(CODE)
	$(RUN)/ruff format --check $(CODE)
	$(RUN)/mypy
	$(RUN)/deptry $(filter-out %.py %.md,$(CODE))
	$(RUN)/lint-imports

$(VENV)/.docs: $(VENV)/.dev
	$(INSTALL) -e '.[dev,ycb,ray,docs]'
	@touch $@

reports: $(VENV)/.dev ## write the pages of results from their rows, and list rows that a change may have moved
	$(RUN)/python -m studies.make_results
	$(RUN)/python -m studies.stale

docs: $(VENV)/.docs ## build the documentation in out/site; a broken link is an error
	$(RUN)/mkdocs build --strict

images: $(VENV)/.all ## draw the pictures of the README and the gallery again
	$(RUN)/python docs/make_images.py
	$(RUN)/python -m docs.make_photos

dist: $(VENV)/.dev ## build the wheel and the source distribution in dist, and check them
	rm -rf dist
	$(RUN)/python -m build
	$(RUN)/twine check --strict dist/*

test-wheel: dist ## the quick tests against the built wheel, in an environment of its own away from here (PYTHON=...)
	@set -e; away=$$(mktemp -d); trap 'rm -rf "$$away"' EXIT; echo "in $$away, with $$($(PYTHON) --version)"; \
	tar -xzf dist/*.tar.gz --strip-components=1 -C "$$away"; rm -r "$$away/cluttergen_jax"; find "$$away/scenes" -mindepth 1 -maxdepth 1 ! -name furniture -exec rm -r {} +; \
	$(PYTHON) -m venv "$$away/.venv"; \
	"$$away/.venv/bin/pip" install --quiet -c constraints.txt "$$(echo dist/*.whl)[dev,ycb,ray,robot,record,video,coco]"; \
	cd "$$away" && .venv/bin/pytest -n auto --maxprocesses 4 --dist loadfile -m "not slow" $(TESTS)

format: $(VENV)/.dev ## let ruff mend what it can
	$(RUN)/ruff check --fix $(CODE)
	$(RUN)/ruff format $(CODE)

scenes: $(VENV)/.dev ## build the embedded pools, supports and ready scenes again
	$(RUN)/python scenes/build.py
	$(RUN)/python -m scenes.build_supports
	$(RUN)/python scenes/build_ready.py

bench: $(VENV)/.all ## measure contact, last check and engines again; renews reports/benchmarks.md
	$(RUN)/python -m studies.benchmarks.contact --write
	$(RUN)/python -m studies.benchmarks.last_check --write
	$(RUN)/python -m studies.benchmarks.engines --write

clean: ## remove what these commands made
	rm -rf $(VENV) out build dist .pytest_cache .ruff_cache .mypy_cache
