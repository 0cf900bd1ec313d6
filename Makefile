# The two commands of the project are `make demo` and `make test`; both set up what is missing. `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help

# What a new set-up or a new build depends on; Python sources, launch files and yaml are used in place.
MANIFESTS := apt-packages.txt apt-packages-noetic.txt requirements.txt requirements-dev.txt tools/setup.sh \
  $(shell find src \( -name package.xml -o -name CMakeLists.txt -o -name setup.py -o -name '*.msg' -o -name '*.srv' -o -name '*.sh.develspace.in' \) -not -path src/CMakeLists.txt)
READY := build/.ready
IN_WORKSPACE := source devel/setup.bash &&

# Arguments of the demo, see `make help`.
HEADLESS ?= 0
DURATION ?=
RECORDING ?=
OFFSET ?=
RECORD ?=
SCENARIO ?=
REPORT ?=
ARGS ?=
# Arguments of the benchmarks.
ONLY ?=
JSON ?=

.PHONY: help setup demo test test-fast bench lint docs docs-pictures cad clean distclean

help: ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /  make \1\t/' | expand -t 20
	@printf '\n  make demo takes HEADLESS=1 (no screen), DURATION=seconds, RECORDING=file of Leap frames, OFFSET="x y z" [mm],\n  REPORT=file for the summary as JSON, RECORD=file.mp4 (a film of the simulated world) or file.png (a sheet of pictures),\n  SCENARIO=pick_cup (the simulated person picks a cup up) or assisted_grasp (the person corrects a grasp that the network proposes),\n  ARGS="name:=value ..." for the launch file.\n\n  make bench takes ONLY="part ..." (see bench/README.md) and JSON=file; `python -m bench.compare OLD NEW` compares two such files.\n'

setup: $(READY) ## installs what is missing and builds the workspace
	@echo "The workspace is set up; in any terminal: source $(CURDIR)/devel/setup.bash"

$(READY): $(MANIFESTS)
	@tools/setup.sh
	@touch $@

demo: $(READY) ## the whole rig: a recorded or scripted hand moves the simulated arm and hand
	@$(IN_WORKSPACE) devel/lib/leap_rig/demo.py $(if $(filter 1 true yes,$(HEADLESS)),--headless) $(if $(DURATION),--duration $(DURATION)) \
	  $(if $(RECORDING),--recording "$(RECORDING)") $(if $(OFFSET),--offset $(OFFSET)) $(if $(REPORT),--report "$(REPORT)") \
	  $(if $(RECORD),--record "$(RECORD)") $(if $(SCENARIO),--scenario $(SCENARIO)) -- $(ARGS)

test: $(READY) ## all tests
	@$(IN_WORKSPACE) tools/test.sh

test-fast: $(READY) ## the tests that need no ROS, in seconds
	@.venv/bin/python -m pytest -n 2 --dist loadfile -m "not ros"

bench: $(READY) ## measures speed on this machine and prints a table
	@$(IN_WORKSPACE) python bench/run.py $(foreach part,$(ONLY),--only $(part)) $(if $(JSON),--json "$(JSON)")

lint: $(READY) ## style, types, packages, shell scripts, architecture, handbook
	@.venv/bin/ruff check . && .venv/bin/ruff format --check .
	@.venv/bin/mypy
	@catkin_lint --offline --strict --quiet --ignore plugin_depend src
	@shellcheck --exclude SC1091 .ci/run $$(find src tools bench -name '*.sh')
	@shellcheck --shell sh $$(find src -name '*.sh.develspace.in')
	@.venv/bin/python -m pytest -q tests/test_architecture.py
	@.venv/bin/mkdocs build --strict --quiet --site-dir build/site

docs: $(READY) ## the handbook in site/, its reference pages made anew from the source
	@$(IN_WORKSPACE) python -m tools.reference
	@.venv/bin/mkdocs build --strict --quiet
	@echo "The handbook is made: site/index.html"

docs-pictures: $(READY) ## the pictures of the handbook, by the programs that they show; takes long
	@$(IN_WORKSPACE) python -m tools.pictures

cad: $(READY) ## exports the printed parts again: STEP, STL, drawings, pictures, tag sheets
	@test -x cad/.venv/bin/python || /usr/bin/python3 -m venv cad/.venv
	@cad/.venv/bin/pip install -q -r cad/requirements.txt
	@cad/.venv/bin/python -m cad.build
	@MUJOCO_GL=egl .venv/bin/python -m cad.pictures
	@.venv/bin/python -m cad.tag_sheets.sheets

clean: ## removes the build
	rm -rf build devel install logs site src/CMakeLists.txt .catkin_workspace .pytest_cache .hypothesis .mypy_cache .ruff_cache

distclean: clean ## removes the build and the Python environment
	rm -rf .venv cad/.venv
