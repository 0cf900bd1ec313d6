# The two commands of the project are `make demo` and `make test`; both set up what is missing. `make help` lists the rest.
SHELL := /bin/bash
.DEFAULT_GOAL := help

# What a new set-up or a new build depends on; Python sources, launch files and yaml are used in place.
MANIFESTS := apt-packages.txt apt-packages-noetic.txt requirements.txt requirements-dev.txt requirements-noetic.txt requirements-webcam.txt tools/setup.sh \
  $(shell find src \( -name package.xml -o -name CMakeLists.txt -o -name setup.py -o -name '*.msg' -o -name '*.srv' -o -name '*.sh.in' \) -not -path src/CMakeLists.txt)
READY := build/.ready
BUILT_IN := $(shell sed -n 's|^CMAKE_HOME_DIRECTORY:INTERNAL=\(.*\)/src$$|\1|p' build/CMakeCache.txt 2> /dev/null)
IN_WORKSPACE := source devel/setup.bash &&

# Arguments of the demo, see `make help`.
HEADLESS ?= 0
DURATION ?=
RECORDING ?=
OFFSET ?=
RECORD ?=
SCENARIO ?=
TUTORIAL ?= 0
TRACKER ?=
VIEW ?=
REPORT ?=
ARGS ?=
ROS ?= 0
# Hours of `make soak`, minutes of `make fuzz`.
HOURS ?= 2
MINUTES ?= 60
# Arguments of the benchmarks.
ONLY ?=
JSON ?=

ifneq ($(filter-out $(CURDIR),$(BUILT_IN)),)
.PHONY: $(READY)  # the folder was moved
endif
.PHONY: help setup environment demo test test-fast test-noetic test-long bench golden campaign networks soak fuzz lint docs docs-pictures cad wheels objects lerobot ros2 clean distclean

help: ## this list
	@grep -hE '^[a-z0-9-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z0-9-]+):.*## /  make \1\t/' | expand -t 20
	@printf '\n  make demo takes HEADLESS=1 (no screen), DURATION=seconds, RECORDING=file of Leap frames, OFFSET="x y z" [mm],\n  REPORT=file for the summary as JSON, RECORD=file.mp4 (a film of the simulated world) or file.png (a sheet of pictures),\n  SCENARIO=pick_cup (the simulated operator picks a cup up), assisted_grasp (the operator corrects a grasp that the network proposes), wall (the hand steers against a wall of objects),\n  clutch or two_hands (relative engagement: the clutch is a service, or the fist of the second hand), episodes (a cup that stands elsewhere in each of ARGS="rounds:=N"), policy (a trained network picks it up, and the operator takes over once),\n  two_cups with ARGS="robots:=2" (two arms, and each hand picks up a cup),\n  TRACKER=webcam (your own hand before the camera moves the arm; ARGS="camera_device:=1" is another camera) headset (by the browser of a headset), or none (no teleoperation: your own node moves the arm),\n  VIEW=rviz, browser (a page, which has the controls, too), both or none,\n  TUTORIAL=1 (leads a visitor step by step; with HEADLESS=1 the simulated operator plays it),\n  ARGS="name:=value ..." for the launch file.\n\n  make bench takes ONLY="part ..." (see bench/README.md) and JSON=file; `python -m bench.compare OLD NEW` compares two such files.\n\n  make campaign takes ONLY=1,8 (or 1-8, or dangerous) and JSON=file,\n  make networks ONLY=arm:loss_5 (or arm, or loss_5) and JSON=file.\n'

setup: $(READY) ## installs what is missing and builds the workspace
	@echo "The workspace is set up; in any terminal: source $(CURDIR)/devel/setup.bash"

environment: ## only the Python environment, for a clone in the src of a catkin workspace
	@tools/setup.sh make_environment

$(READY): $(MANIFESTS)
	@tools/setup.sh
	@touch $@

demo: $(READY) ## the whole rig: a recorded or scripted hand moves the simulated arm and hand
	@$(IN_WORKSPACE) devel/lib/leap_rig/demo.py $(if $(filter 1 true yes,$(HEADLESS)),--headless) $(if $(DURATION),--duration $(DURATION)) \
	  $(if $(RECORDING),--recording "$(RECORDING)") $(if $(OFFSET),--offset $(OFFSET)) $(if $(REPORT),--report "$(REPORT)") \
	  $(if $(RECORD),--record "$(RECORD)") $(if $(SCENARIO),--scenario $(SCENARIO)) $(if $(TRACKER),--tracker $(TRACKER)) $(if $(VIEW),--view $(VIEW)) $(if $(filter 1 true yes,$(TUTORIAL)),--tutorial) -- $(ARGS)

test: $(READY) ## all tests
	@tools/test.sh

test-fast: $(READY) ## the tests that only compute, without ROS; part of `make test`
	@.venv/bin/python -m pytest -n "$$(nproc)" --dist worksteal -m "not ros and not real and not long"

test-noetic: ## the tests that only compute, on Python 3.8 where there is one; ROS=1: nodes and the demo there instead
	@tools/noetic.sh $(if $(filter 1 true yes,$(ROS)),--ros)

test-long: $(READY) ## before a release: what takes hours, by the real clock; prints a table at the end
	@$(IN_WORKSPACE) python -m tools.test_long

bench: $(READY) ## measures speed on this machine and prints a table
	@$(IN_WORKSPACE) python bench/run.py $(foreach part,$(ONLY),--only $(part)) $(if $(JSON),--json "$(JSON)")

campaign: $(READY) ## provokes the faults of the catalogue on simulated rigs and judges what the arm does
	@$(IN_WORKSPACE) python -m campaign.run $(if $(ONLY),--only "$(ONLY)",--page) $(if $(JSON),--json "$(JSON)")

networks: $(READY) ## the simulated rig on bad networks: delay, jitter, loss, freezes on each of its wires; 12 minutes
	@$(IN_WORKSPACE) python -m campaign.network.run --page $(if $(ONLY),--only "$(ONLY)") $(if $(JSON),--json "$(JSON)")

soak: $(READY) ## HOURS=2 of work with faults on the whole simulated rig: does memory, or anything else, grow?
	@$(IN_WORKSPACE) python campaign/soak.py --hours "$(HOURS)"

golden: $(READY) ## renews what the replay gate compares with, and draws old and new where they differ
	@$(IN_WORKSPACE) OPENBLAS_NUM_THREADS=1 python -m golden

fuzz: $(READY) ## MINUTES=60 of input that nobody meant, for every parser and border
	@$(IN_WORKSPACE) python -m fuzz.run --minutes "$(MINUTES)"

lint: $(READY) ## style, types, packages, shell scripts, architecture, handbook
	@.venv/bin/ruff check . && .venv/bin/ruff format --check .
	@.venv/bin/mypy
	@.venv/bin/python -m tools.python38
	@catkin_lint --offline --strict --quiet --ignore plugin_depend src
	@shellcheck --exclude SC1091 .ci/run $$(find src tools bench -name '*.sh')
	@shellcheck --shell sh $$(find src -name '*.sh.in')
	@.venv/bin/python -m pytest -q tests/test_architecture.py
	@.venv/bin/mkdocs build --strict --quiet --site-dir build/site

docs: $(READY) ## the handbook in site/, its reference pages made anew from the source
	@$(IN_WORKSPACE) python -m tools.reference
	@.venv/bin/mkdocs build --strict --quiet
	@echo "The handbook is made: site/index.html"

docs-pictures: $(READY) ## the pictures of the handbook, by the programs that they show; takes long
	@$(IN_WORKSPACE) python -m tools.pictures

cad: $(READY) ## exports the printed parts again: STEP, STL, drawings, pictures, tag sheets
	@cad/.venv/bin/python -m pip --version > /dev/null 2>&1 || /usr/bin/python3 -m venv cad/.venv
	@cad/.venv/bin/pip install -q -r cad/requirements.txt
	@cad/.venv/bin/python -m cad.build
	@MUJOCO_GL=egl .venv/bin/python -m cad.pictures
	@.venv/bin/python -m cad.tag_sheets.sheets

wheels: $(READY) ## the libraries that need no ROS, for pip: build/wheels
	@tools/wheels.sh

objects: $(READY) ## installs pybullet for its objects random_urdfs, to train or test a network of lifts (280 MB)
	@.venv/bin/pip install -q --no-deps -r requirements-objects.txt

lerobot: ## installs LeRobot into .venv-lerobot, for export_recording.py --lerobot (8 GB from PyPI)
	@.venv-lerobot/bin/python -m pip --version > /dev/null 2>&1 || /usr/bin/python3 -m venv .venv-lerobot
	@.venv-lerobot/bin/pip install -q -r requirements-lerobot.txt

ros2: ## installs ROS 2 into .venv-ros2, for ros2_bridge.py and export_recording.py --ros2 (400 MB)
	@tools/ros2.sh

clean: ## removes the build
	rm -rf build devel install logs site src/CMakeLists.txt .catkin_workspace .pytest_cache .hypothesis .mypy_cache .ruff_cache

distclean: clean ## removes the build and all Python environments
	rm -rf .venv .venv-noetic .venv-lerobot .venv-ros2 cad/.venv
