# make demo [SECONDS=20]   the pair end to end, with a virtual device of every kind
# make test                the unit tests; needs no root and no system package
# make check               style, types, imports, documents
# make seams               each joint of real parts (root, tests/system/packages.txt)
# make nightly             everything else, in parts that can be resumed: build/nightly.md
# make faults [LONG=1]     every fault as long as in a lab
# make fuzz [SECONDS=60 SEED=0]  every parser, with inputs that nobody thought of
# make explore             every property, with new examples
# make installer           the Windows installer, built under Wine
# make docs                what documents show of the code: tables of sensors, topics, decisions
# make docs-site           the documents as a site, in build/site
# make pictures            the pictures of the demo and of the page, from real runs
# make containers [ENGINE=docker BASE=]  the agent and the node as images of containers
# make changelog [VERSION=]  the fragments of changelog.d joined into CHANGELOG.md; shown without a version
# make bench, make format, make lock
SHELL := /bin/sh
PYTHON_FILES := benchmarks common examples gateway_win hatch_build.py installer ros_side tests typings
RUN := .venv/bin/python -m
SECONDS :=
ENGINE := docker
# The tests start thousands of programs. Where the environment forbids Python to keep what it has
# compiled, as in many containers, each of them would compile all that it imports.
unexport PYTHONDONTWRITEBYTECODE
export PYTHONPYCACHEPREFIX := $(CURDIR)/build/bytecode
# Not --quiet, which would silence the warnings that strict mode counts. The theme tells of MkDocs 2.0;
# the lock has 1.6.
DOCS_SITE := NO_MKDOCS_2_WARNING=1 .venv/bin/mkdocs build --strict
# Tests of real parts wait most of their time, so that three fit on two cores; each process has an
# LSL session and a ROS domain of its own.
SIDE_BY_SIDE := -n 3 --dist loadfile --no-loadscope-reorder

.PHONY: demo test seams nightly explore faults fuzz installer check bench format docs docs-site changelog
.PHONY: pictures containers lock venv-ros venv-dev venv-kilted venv-peers venv-psychopy

demo: venv-ros
	.venv/bin/biosensor-gateway demo $(if $(SECONDS),--seconds $(SECONDS))

test: venv-dev
	$(RUN) pytest --tier unit -n auto

seams: venv-dev
	$(RUN) pytest --tier seams $(SIDE_BY_SIDE)

# Each property with examples of its own, other ones each time.
explore: venv-dev
	$(RUN) pytest --tier unit --hypothesis-profile=explore -n auto $(shell grep -rl --include='test_*.py' '@given' tests)

# Each fault as long as in a lab, half an hour of steady streaming; LONG: twelve hours of it.
faults: venv-dev
	BIOSENSOR_GATEWAY_FAULTS=long $(if $(LONG),BIOSENSOR_GATEWAY_STEADY_S=43200) $(RUN) pytest --tier nightly tests/faults

fuzz: venv-dev
	$(RUN) tests.fuzz --seconds $(or $(SECONDS),60) --seed $(or $(SEED),0)

nightly: venv-peers
	$(RUN) tests.nightly $(if $(PART),--part $(PART)) $(if $(AGAIN),--again)

installer: venv-dev
	$(RUN) installer.wine

check: venv-dev
	$(RUN) ruff check $(PYTHON_FILES)
	$(RUN) ruff format --check $(PYTHON_FILES)
	.venv/bin/pyright
	.venv/bin/lint-imports
	$(RUN) tests.docs.house
	$(DOCS_SITE)

bench: venv-dev
	$(RUN) benchmarks

format: venv-dev
	$(RUN) ruff check --fix --quiet $(PYTHON_FILES)
	$(RUN) ruff format $(PYTHON_FILES)

docs: venv-dev
	$(RUN) tests.docs.generate

containers: venv-dev
	rm -rf build/containers
	.uv/bin/uv build --quiet --wheel --out-dir build/containers .
	cp .uv/bin/uv requirements/gateway.txt requirements/ros.txt build/containers
	for image in agent node; do \
	    $(ENGINE) build --file containers/Containerfile --target $$image --tag biosensor-gateway-$$image \
	        $(OPTIONS) $(if $(BASE),--build-arg BASE=$(BASE)) build/containers || exit 1; \
	done

docs-site: venv-dev
	$(DOCS_SITE)

changelog: venv-dev
	.venv/bin/towncrier build --version $(or $(VERSION),X.Y.Z) $(if $(VERSION),--yes,--draft)

pictures: venv-dev
	$(RUN) tests.docs.demo_picture docs/pictures/demo.svg
	$(RUN) tests.docs.page_picture docs/pictures

lock: venv-dev
	requirements/compile.sh

venv-ros:
	@requirements/install.sh ros

venv-dev:
	@requirements/install.sh dev

venv-kilted:
	@requirements/install.sh kilted .venv-kilted

venv-peers: venv-dev
	@tests/peers/install.sh

venv-psychopy: venv-dev
	@tests/examples/psychopy/install.sh
