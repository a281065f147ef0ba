# make help lists the targets. Every target rebuilds what changed.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
PACKAGES := git make g++ python3-dev python3-venv
NATIVE := $(wildcard tracer/native/*.cpp tracer/native/*.hpp)
PYTHONS := $(shell find tracer converters validation -name '*.py')
EXTRAS := build/stability.json build/speed.json
CPUS := $(shell nproc 2>/dev/null || echo 2)

.PHONY: help demo regression certify test lint docs clean install always
.DEFAULT_GOAL := help

help:
	@echo "make install     build everything into .venv, as the other targets do first"
	@echo "make demo        validate the bundled scenes against Mitsuba and write report/index.html"
	@echo "make regression  every pass of the bundled scenes against every reference, to build/results-*.json"
	@echo "make certify     prove pixels of the bundled scenes and hold our renderers against them"
	@echo "make test        run the whole test suite"
	@echo "make lint        ruff, mypy, import-linter, clang-format, and C++ without a warning"
	@echo "make docs        draw every generated picture of docs/ with the commands of this project"
	@echo "make clean       remove everything that the other targets made"

# The system packages, checked by what they bring.
$(VENV)/checked: Makefile
	@missing=; \
	command -v git >/dev/null || missing="$$missing git"; \
	command -v g++ >/dev/null || missing="$$missing g++"; \
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || missing="$$missing python3(>=3.11)"; \
	$(PYTHON) -c 'import ensurepip, venv' 2>/dev/null || missing="$$missing python3-venv"; \
	$(PYTHON) -c 'import os, sys, sysconfig; sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))' 2>/dev/null || missing="$$missing python3-dev"; \
	if [ -n "$$missing" ]; then \
		echo "error: missing on this system:$$missing"; \
		echo "  hint: sudo apt-get install $(PACKAGES)"; \
		exit 2; \
	fi
	@mkdir -p $(VENV) && touch $@

# What the project needs to be built, tested and checked: the group `dev` of pyproject.toml.
$(VENV)/dependencies: $(VENV)/checked pyproject.toml
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --upgrade 'pip>=25.1'
	$(BIN)/pip install --quiet --group dev
	@touch $@

# An editable installation knows the Python files by their names: this changes when one comes or goes.
$(VENV)/files: $(VENV)/dependencies always
	@find tracer converters validation -name '*.py' | LC_ALL=C sort > $@.new
	@if cmp -s $@.new $@; then rm $@.new; else mv $@.new $@; fi

# Editable: Python files are used where they lie; C++ is compiled again when it changed.
$(VENV)/installed: $(VENV)/dependencies $(VENV)/files CMakeLists.txt $(NATIVE)
	$(BIN)/pip install --quiet --no-build-isolation --editable .
	@touch $@

install: $(VENV)/installed

demo: install $(EXTRAS)
	@echo "3 of 3: the bundled scenes, about a minute"
	$(BIN)/whitted validate scenes/gallery scenes/spec --against mitsuba-spec --report report \
		$(addprefix --include ,$(EXTRAS)); status=$$?; \
	$(BIN)/whitted renderers --missing; exit $$status

# What the report of the demo shows besides. What breaks or is missing there is told there, and does not fail the demo.
build/stability.json: $(VENV)/installed $(PYTHONS)
	@mkdir -p build
	@echo "1 of 3: how hard a scene may get, on 4 ladders; Mitsuba breaks on one"
	$(BIN)/whitted stability -q --ladder far-on-axis,mirrors,blocker-light,exponent \
		--renderer native-f64,native-f32,numpy-f64,mitsuba-spec --json $@ || test -s $@

build/speed.json: $(VENV)/installed $(PYTHONS) | build/stability.json
	@mkdir -p build
	@echo "2 of 3: speed against error, of one scene"
	$(BIN)/whitted speed -q scenes/gallery/mirrors.txt --size 200x200 --rounds 5 --seconds 0.3 --limit 8 \
		--pixels 100 --edges 20 --json $@ || test -s $@

# The whole regression suite: every pass of every bundled scene, against every reference, at full size.
regression: install
	@$(call VALIDATE,gallery) & other=$$!; $(call VALIDATE,spec); spec=$$?; \
	wait $$other; gallery=$$?; cat build/regression-gallery.txt build/regression-spec.txt; \
	$(BIN)/whitted renderers --missing; exit $$((gallery > spec ? gallery : spec))

# Of one folder; both at once, as most of it uses one processor.
VALIDATE = mkdir -p build; $(BIN)/whitted validate scenes/$(1) --json build/results-$(1).json \
	--against mitsuba-stock,mitsuba-spec,mitsuba-path,povray >build/regression-$(1).txt 2>&1

certify: install
	$(BIN)/whitted truth scenes/gallery scenes/spec --renderer native-f64,native-f32,numpy-f64,numpy-f32 \
		--pixels 2000 --edges 500

test: install
	$(BIN)/python -m pytest -n $(CPUS) --dist worksteal; status=$$?; $(BIN)/whitted renderers --missing; exit $$status

lint: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	@if command -v tsc >/dev/null; then echo tsc -p validation/report/viewer; tsc -p validation/report/viewer; \
	else echo "the viewer's types are not checked: apt-get install node-typescript"; fi
	$(BIN)/clang-format --dry-run --Werror $(NATIVE)
	PATH="$(abspath $(BIN)):$$PATH" cmake -S . -B build/lint -G Ninja -DWHITTED_WERROR=ON -DWHITTED_PYTHON=ON \
		-DPython_EXECUTABLE="$(abspath $(BIN))/python" -Dnanobind_DIR="$$($(BIN)/python -m nanobind --cmake_dir)" >/dev/null
	PATH="$(abspath $(BIN)):$$PATH" cmake --build build/lint --target raytrace _native

# Screenshots need Chromium; the plot of speed is measured anew with SPEED=1 alone: it depends on the machine.
docs: install
	$(BIN)/python docs/pictures.py

clean:
	rm -rf $(VENV) build dist report tracer/_native.pyi .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
