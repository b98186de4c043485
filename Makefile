# make demo [SECONDS=20]   the pair end to end, with a virtual device of every kind
# make test                checks and tests; needs no root, no ROS, no second step
# make test-system         what needs root or system packages (tests/system/packages.txt)
# make faults [LONG=1]     every fault as long as in a lab; LONG: 12 hours of steady streaming
# make fuzz [SECONDS=60 SEED=0]  every parser, with inputs that nobody thought of
# make installer           the Windows installer, built under Wine (needs the same packages)
# make docs                what documents show of the code: tables of sensors, topics, decisions
# make docs-site           the documents as a site, in build/site
# make pictures            the pictures of the demo and of the page, from real runs
# make check, make bench, make format, make lock
SHELL := /bin/sh
PYTHON_FILES := common gateway_win installer ros_side tests typings
RUN := .venv/bin/python -m
SECONDS :=
# The tests start thousands of programs. Where the environment forbids Python to keep what it has
# compiled, as in many containers, each of them would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/build/bytecode
# Not --quiet, which would silence the warnings that strict mode counts. The theme tells of MkDocs 2.0;
# the lock has 1.6.
DOCS_SITE := NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict
# Most of their time tests wait for devices that stream in real time, so that several workers
# fit on two cores; each has an LSL session and a ROS domain of its own. The longest files come
# first, as tests/budget.toml has them, else the last of them would run alone for minutes.
SIDE_BY_SIDE := --dist loadfile --no-loadscope-reorder --hold-budget
# The files of the few tests with a marker; to look through all of them takes a while.
MARKED = $(shell grep -rl --include='test_*.py' 'pytest.mark.$(1)' tests | sort)
# These run many programs each, and four at a time would be late by their own load.
MANY_PROGRAMS := tests/e2e tests/faults tests/faults/scenarios tests/peers tests/ros

.PHONY: demo test test-system tests tests-of-parts tests-of-programs system-tests tests-alone
.PHONY: explore faults fuzz installer check bench format docs docs-site pictures lock venv-ros venv-dev venv-peers

demo: venv-ros
	.venv/bin/biosensor-gateway demo $(if $(SECONDS),--seconds $(SECONDS))

test: check tests
	$(RUN) pytest -m "alone and not system" $(call MARKED,alone)
	@echo
	@echo "Not run here, only by 'make test-system' (needs root and system packages):"
	@$(RUN) pytest -m system --collect-only -qq $(call MARKED,system) | sed 's/^/  /'

test-system: system-tests
	$(RUN) pytest -m "alone and system" $(call MARKED,alone)

# The parts of the two, as .ci/run takes them.
tests: tests-of-parts tests-of-programs

tests-of-parts: venv-dev
	$(RUN) pytest -m "not system and not alone" $(SIDE_BY_SIDE) -n 5 $(MANY_PROGRAMS:%=--ignore=%)

tests-of-programs: venv-peers
	$(RUN) pytest -m "not system and not alone" $(SIDE_BY_SIDE) -n 3 $(MANY_PROGRAMS)

system-tests: venv-peers installer
	$(RUN) pytest -m "system and not alone" $(SIDE_BY_SIDE) -n 3 $(call MARKED,system)

tests-alone: venv-dev
	$(RUN) pytest -m alone $(call MARKED,alone)

# Each property with examples of its own, other ones each time.
explore: venv-dev
	$(RUN) pytest --hypothesis-profile=explore -m "not system and not alone" --dist loadfile -n 2 $(shell grep -rl --include='test_*.py' '@given' tests)

faults: venv-dev
	BIOSENSOR_GATEWAY_FAULTS=long $(if $(LONG),BIOSENSOR_GATEWAY_STEADY_S=43200) $(RUN) pytest tests/faults

fuzz: venv-dev
	$(RUN) tests.fuzz --seconds $(or $(SECONDS),60) --seed $(or $(SEED),0)

installer: venv-dev
	$(RUN) installer.wine

check: venv-dev
	$(RUN) ruff check $(PYTHON_FILES)
	$(RUN) ruff format --check $(PYTHON_FILES)
	.venv/bin/pyright
	.venv/bin/lint-imports
	$(DOCS_SITE)

bench: venv-dev
	$(RUN) tests.bench

format: venv-dev
	$(RUN) ruff check --fix --quiet $(PYTHON_FILES)
	$(RUN) ruff format $(PYTHON_FILES)

docs: venv-dev
	$(RUN) tests.docs.generate

docs-site: venv-dev
	$(DOCS_SITE)

pictures: venv-dev
	$(RUN) tests.docs.demo_picture docs/pictures/demo.svg
	$(RUN) tests.docs.page_picture docs/pictures

lock: venv-dev
	requirements/compile.sh

venv-ros:
	@requirements/install.sh ros

venv-dev:
	@requirements/install.sh dev

venv-peers: venv-dev
	@tests/peers/install.sh
