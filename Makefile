# Copyright 2026 starcal_ros contributors
# SPDX-License-Identifier: Apache-2.0

# Everything a fresh machine needs: each target first makes .venv, with ROS 2 in it, from PyPI.

.PHONY: help demo test test-slow lint docs audit reliability clean browser
.DEFAULT_GOAL := help

# The ROS 2 in .venv must not meet one that the shell has sourced.
unexport PYTHONPATH LD_LIBRARY_PATH AMENT_PREFIX_PATH CMAKE_PREFIX_PATH
unexport RMW_IMPLEMENTATION ROS_DISTRO _ROS_WHEELS_BOOTSTRAP_COMPLETE
export PATH := $(CURDIR)/.venv/bin:$(PATH)
export PIP_DISABLE_PIP_VERSION_CHECK := 1

help:
	@echo 'make demo   simulate a star tracker and its gyros, calibrate them; results in demo/'
	@echo 'make test   the test suite, style included, but for what takes long'
	@echo 'make test-slow   the rest: statistics of many runs, whole studies, all pages of docs'
	@echo 'make lint   style, types and the direction of imports only'
	@echo 'make docs   the documentation, from build/docs/index.html on'
	@echo 'make audit  known vulnerabilities of what is installed, by pip-audit'
	@echo 'make reliability   docs/reliability.md, from its tests and the results of bench/'
	@echo 'make clean  remove what the others made'

demo: .venv/installed
	.venv/bin/starcal demo
	@echo; ls -lR demo

# On two cores, each file of tests on one of them, with one thread of its own; then those of the
# nodes, of which a test starts up to six, with the machine to themselves.
test: MARKED := not slow
test-slow: MARKED := slow
test test-slow: .venv/installed browser
	OPENBLAS_NUM_THREADS=1 .venv/bin/pytest -m '$(MARKED)' -n 2 --dist loadfile \
	    --ignore test/nodes --durations 30 test
	OPENBLAS_NUM_THREADS=1 .venv/bin/pytest -m '$(MARKED)' --durations 10 test/nodes

# A browser that the pages are tested in; without one those tests are skipped.
browser:
	@command -v chromium >/dev/null || [ "$$(id -u)" != 0 ] || { \
	    echo 'Installing chromium, to test the pages in'; \
	    apt-get update -qq && DEBIAN_FRONTEND=noninteractive \
	        apt-get install -y -qq chromium >/dev/null; } || \
	    echo 'No chromium: the pages are not tested in a browser' >&2

lint: .venv/installed
	.venv/bin/pytest test/test_style.py

docs: .venv/installed
	.venv/bin/sphinx-build -W --keep-going -q docs build/docs
	@echo 'Documentation: build/docs/index.html'

# Asks PyPI, so it is no test.
audit: .venv/installed
	.venv/bin/python scripts/audit.py

# The tests that docs/reliability.md names, and the page from their report.
reliability: .venv/installed
	.venv/bin/pytest --junitxml=build/tests.xml $$(.venv/bin/python scripts/make_reliability.py --list)
	.venv/bin/python scripts/make_reliability.py build/tests.xml

clean:
	rm -rf .venv demo build docs/api *.egg-info .mypy_cache .pytest_cache .hypothesis
	find . -name __pycache__ -prune -exec rm -r {} +

# The checkout itself, copied into .venv anew when anything in it changes, a file removed
# included (hence the folders). Not editable: that would leave out launch/ and config/.
SOURCES := package.xml $(shell find bin config launch resource starcal_ros \
    -name __pycache__ -prune -o -print)

.venv/installed: .venv/ready $(SOURCES)
	@rm -rf build
	@.venv/bin/pip install --quiet --no-deps --no-index --no-build-isolation --force-reinstall .
	@cd .venv && bin/python -m starcal_ros.filter.arithmetic
	@cd .venv && bin/python -m starcal_ros.calibration.frame_arithmetic
	@cd .venv && bin/python -m starcal_ros.calibration.interstar_arithmetic
	@touch $@

# What it stands on, made from nothing when the dependencies change. The interpreter is the
# first for which the ROS 2 wheels exist.
define find_python
for python in python3.11 python3 python3.12 python3.13 python3.10; do \
    $$python -c 'import ensurepip, sys; sys.exit(not (3, 10) <= sys.version_info[:2] <= (3, 13))' \
        2>/dev/null && break; python=; done
endef

.venv/ready: setup.py setup.cfg pyproject.toml
	@test "$$(uname -sm)" = 'Linux x86_64' || { \
	    echo 'PyPI has ROS 2 for Linux on x86-64 only. Elsewhere install ROS 2, then colcon build.'; \
	    exit 1; } >&2
	@$(find_python); if [ -z "$$python" ]; then \
	    echo 'No Python 3.10-3.13 that can make a virtual environment: installing python3-venv'; \
	    sudo=; [ "$$(id -u)" = 0 ] || sudo=sudo; \
	    $$sudo apt-get update -qq && $$sudo apt-get install -y -qq python3-venv >/dev/null; \
	    $(find_python); fi; \
	if [ -z "$$python" ]; then \
	    echo 'Please install Python 3.10, 3.11, 3.12 or 3.13 with its venv module' \
	         '(Debian, Ubuntu: apt-get install python3-venv), then try again.' >&2; exit 1; fi; \
	echo "Making .venv with $$($$python --version) and ROS 2: a minute or two"; \
	rm -rf .venv && $$python -m venv .venv
	@.venv/bin/pip install --quiet 'setuptools<80' wheel
	@.venv/bin/pip install --quiet '.[ros,test]'
	@touch $@
