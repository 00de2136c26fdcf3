# Every target makes .venv by itself; nothing but Python 3.11 or later with pip and venv is needed.

PYTHON ?= $(shell command -v python3.11 || command -v python3)
PY := .venv/bin/python
WHEEL_VENV := build/wheel-venv
OFFICIAL_VENV := build/official-venv
ADAPTERS_VENV := build/adapters-venv
CLIENTS_VENV := build/clients
BROWSER_VENV := build/browser-venv
MINARI_VENV := build/minari-venv
LLM_VENV := build/llm-venv
DOCS_VENV := build/docs-venv
DOCS_PY := $(DOCS_VENV)/bin/python
CHROMIUM ?= $(shell command -v chromium || command -v chromium-browser || command -v google-chrome)

.DEFAULT_GOAL := help
.DELETE_ON_ERROR:
.PHONY: $(shell sed -nE 's/^([a-z-]+):.*/\1/p' $(firstword $(MAKEFILE_LIST)))

help: ## list the targets
	@grep -hE '^[a-z-]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/make \1\t\2/' | expand -t 24

venv: .venv/.stamp ## make .venv with everything that the other targets need

# `venv` is run on an existing folder too: it completes one whose making was interrupted.
.venv/.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv .venv
	$(PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[dev]'
	@touch $@

run: .venv/.stamp ## train the plan-in-advance agent on basic games and generated scenes, evaluate it on all 40 games
	.venv/bin/iphyre-jax train

on-the-fly: .venv/.stamp ## shipped policies that act on the fly: greedy by mode and by median, beside sampled actions
	$(PY) -m benchmarks.learning.on_the_fly

# Tests start hundreds of processes. Each would translate the package to bytecode again where none may be kept.
PYTEST := PYTHONDONTWRITEBYTECODE= $(PY) -m pytest -n 2 --dist worksteal

test: lint ## lint, types and the test suite
	$(PYTEST)

test-fast: lint ## the same without the tests marked slow, for daily work
	$(PYTEST) -m "not slow"

test-further: .venv/.stamp ## what `make test` leaves out because it takes long: further cases, and some claims
	IPHYRE_JAX_CHECK_ALL=1 $(PYTEST) -m further

test-environments: .venv/.stamp ## gymnasium's check_env on every registered environment; vector environments against single ones
	IPHYRE_JAX_CHECK_ALL=1 $(PY) -m pytest -n 2 tests/adapters/test_gymnasium_check.py tests/adapters/test_gymnasium.py

fuzz: .venv/.stamp ## ten thousand random scenes of 24 layouts, in both number types
	IPHYRE_JAX_FUZZ=10000 $(PY) -m pytest -s tests/scenes/test_fuzz.py

test-adapters: ## the tests of the brax adapter, in an environment of its own, for brax is large
	$(PYTHON) -m venv $(ADAPTERS_VENV)
	$(ADAPTERS_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[brax]' pytest hypothesis
	$(ADAPTERS_VENV)/bin/python -m pytest tests/adapters/test_brax_env.py

test-gpu: .venv/.stamp ## what an NVIDIA GPU plays, beside the CPU; needs one, and jax for it: .venv/bin/pip install "jax[cuda13]"
	IPHYRE_JAX_CHECK_GPU=1 $(PY) -m pytest tests/gpu

# A client that fails does not keep the others from running; what ran goes into the page.
CLIENTS_torch := gymnasium stable_baselines3 cleanrl official
CLIENTS_jax := gymnax purejaxrl rejax brax flashbax jumanji dm_env

test-clients: .venv/.stamp $(CLIENTS_VENV)-torch/.stamp $(CLIENTS_VENV)-jax/.stamp ## trainers and libraries of others over the environments; writes docs/results/clients.md
	rm -rf build/clients
	bad=0; \
	for kind in torch jax; do $(CLIENTS_VENV)-$$kind/bin/python tests/clients/documents.py $$kind || bad=1; done; \
	for client in $(CLIENTS_torch); do $(CLIENTS_VENV)-torch/bin/python tests/clients/$${client}_client.py || bad=1; done; \
	for client in $(CLIENTS_jax); do $(CLIENTS_VENV)-jax/bin/python tests/clients/$${client}_client.py || bad=1; done; \
	$(CLIENTS_VENV)-torch/bin/python examples/stable_baselines3_loop.py || bad=1; \
	$(PY) tests/clients/forty_games_client.py || bad=1; \
	$(PY) tests/clients/render.py && exit $$bad

$(CLIENTS_VENV)-%/.stamp: tests/clients/%.txt
	$(PYTHON) -m venv $(CLIENTS_VENV)-$*
	$(CLIENTS_VENV)-$*/bin/python -m pip install --quiet --disable-pip-version-check --requirement $<
	$(CLIENTS_VENV)-$*/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
	@touch $@

# Scripts of tests/robustness; each writes what it found to build/faults/, and all of it goes into docs/results/faults.md.
FAULTS := attempts kill damage disk_full read_only hostile_files arguments extreme_scenes many_scenes
FAULT_SCRIPT := PYTHONPATH=. $(PY) tests/robustness

test-faults: .venv/.stamp ## the scripts of FAULTS in turn, then docs/results/faults.md; up to an hour and a half
	bad=0; for script in $(FAULTS); do $(FAULT_SCRIPT)/$$script.py || bad=1; done; $(FAULT_SCRIPT)/report.py; exit $$bad

SOAK_MINUTES ?= 60

soak: .venv/.stamp ## an hour of every public call with ever new scenes: memory, compilations, threads and handles stay bounded
	$(FAULT_SCRIPT)/soak.py --minutes $(SOAK_MINUTES) && $(FAULT_SCRIPT)/report.py

test-server: .venv/.stamp ## an hour of attacks on the play server, with a player who notices nothing
	$(FAULT_SCRIPT)/server.py && $(FAULT_SCRIPT)/report.py

test-kill: .venv/.stamp ## 40 kills of training runs, at least 20 of them while saving, each resumed to the same bits
	$(FAULT_SCRIPT)/kill.py

test-damage: .venv/.stamp ## 200 damaged checkpoints, each refused
	$(FAULT_SCRIPT)/damage.py

test-hostile: .venv/.stamp ## hundreds of hostile files, each refused in one line
	$(FAULT_SCRIPT)/hostile_files.py

test-learners: .venv/.stamp ## every learner on all probes with known answers, and against the random agent on two games
	IPHYRE_JAX_CHECK_ALL=1 $(PY) -m pytest -n 2 tests/train/algos
	$(PY) tests/robustness/beats_random.py

test-data: .venv/.stamp ## data sets: counts of all forty games, pymunk in the official order, labels of the whole named sets; half an hour
	$(FAULT_SCRIPT)/datasets.py && $(FAULT_SCRIPT)/datasets.py --sets --whole && $(FAULT_SCRIPT)/datasets.py --kill \
		&& $(FAULT_SCRIPT)/datasets.py --reference

test-minari: ## the tests of the Minari export, in an environment of its own
	$(PYTHON) -m venv $(MINARI_VENV)
	$(MINARI_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[minari]' pytest hypothesis
	$(MINARI_VENV)/bin/python -m pytest tests/data/test_minari_export.py

test-llm: ## the official openai and anthropic packages against a faulty server of this machine, in an environment of its own
	$(PYTHON) -m venv $(LLM_VENV)
	$(LLM_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[train,viewer,llm]' pytest hypothesis
	$(LLM_VENV)/bin/python -m pytest tests/agents/language

results-language: .venv/.stamp ## play the hand-written replies of the package and write docs/results/language.md; asks no model
	.venv/bin/iphyre-jax ask --replay --document docs/results/language.md

test-extremes: .venv/.stamp ## scenes of extreme geometry at both rates, in both number types: finite or at fault, neighbours untouched
	PYTHONPATH=. $(PY) tests/robustness/extreme_scenes.py

test-browser: chromium ## the pages in Chromium, in an environment of its own; screenshots in build/browser/
	$(PYTHON) -m venv $(BROWSER_VENV)
	$(BROWSER_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[train,viewer,browser]' pytest hypothesis
	CHROMIUM="$(CHROMIUM)" JAX_COMPILATION_CACHE_DIR="$(CURDIR)/build/jax-cache" JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS=0.1 \
		$(BROWSER_VENV)/bin/python -m pytest tests/browser -rP

chromium: ## install the distribution's Chromium if there is none (Debian, as root); or say CHROMIUM=/path/to/it
	@test -n "$(CHROMIUM)" || { apt-get update -qq && apt-get install -y -qq chromium; } \
		|| { echo "make chromium: no Chromium, and apt-get cannot install it; say CHROMIUM=/path/to/it"; exit 1; }

pictures: .venv/.stamp ## make the pictures of the README again, docs/pictures/
	$(PY) tools/make_pictures.py

lint: .venv/.stamp ## ruff and mypy only
	$(PY) -m ruff check .
	$(PY) -m ruff format --check .
	$(PY) -m mypy

parity: .venv/.stamp ## compare every game with pymunk, over whole runs
	$(PY) -m parity

parity-random: .venv/.stamp ## compare 2000 random scenes with pymunk; a run that was killed goes on where it was
	$(PY) -m parity.fuzz.random_run

golden: .venv/.stamp ## write the golden files of tests/parity anew, from pymunk
	$(PY) -m parity.golden

parity-official: .venv/.stamp ## compare the environments with the official class, which needs its own old libraries
	$(PYTHON) -m venv $(OFFICIAL_VENV)
	$(OFFICIAL_VENV)/bin/python -m pip install --quiet --disable-pip-version-check 'iphyre==0.2.3' 'pymunk==6.11.1' 'numpy<2' pygame
	$(OFFICIAL_VENV)/bin/python parity/official/record.py build/official.npz --pictures build/pictures.npz
	$(PY) -m parity.official.pictures build/pictures.npz build/pictures.png
	$(PY) -m parity.official.environments build/official.npz

wheel: .venv/.stamp ## build the wheel and try it in a clean environment without extras
	rm -rf dist $(WHEEL_VENV)
	$(PY) -m pip wheel --quiet --disable-pip-version-check --no-deps --wheel-dir dist .
	$(PYTHON) -m venv $(WHEEL_VENV)
	$(WHEEL_VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt dist/*.whl
	$(WHEEL_VENV)/bin/python -I tests/check_wheel.py

results: .venv/.stamp ## train five seeds of every agent and write docs/results/results.md; goes on where it stopped
	$(PY) -m benchmarks.learning.agents --weights iphyre_jax/train/weights

results-paper: .venv/.stamp ## five seeds of every agent with the paper's settings; writes docs/results/results-paper.md
	$(PY) -m benchmarks.learning.agents --table paper

results-controllers: .venv/.stamp ## three seeds of agents that see predictions of world models; writes docs/results/results-controllers.md; needs results-world
	$(PY) -m benchmarks.learning.agents --table controllers --seeds 3

analyse: .venv/.stamp ## every table of the analyses and its data, row by row in build/analyses; goes on where it stopped
	.venv/bin/iphyre-jax analyse --data iphyre_jax/analyses

test-oracle: .venv/.stamp ## play every plan of the shipped oracle again, in float64
	$(FAULT_SCRIPT)/oracle_proofs.py

results-offline: .venv/.stamp ## train every outcome classifier and write docs/results/outcome.md; goes on where it stopped
	.venv/bin/iphyre-jax classifier compare --weights iphyre_jax/models/outcome/weights

carry-over: .venv/.stamp ## train the default agent and variants of it, at 10 and 60 steps a second; writes docs/results/carry-over.md; goes on where it stopped
	$(PY) -m benchmarks.learning.carry_over --weights iphyre_jax/models/outcome/weights

results-sequence: .venv/.stamp ## train every sequence model and write docs/results/sequence.md; goes on where it stopped
	.venv/bin/iphyre-jax sequence compare --weights iphyre_jax/models/sequence/weights

results-world: .venv/.stamp ## train the world models, three seeds each, and write docs/results/world.md; goes on where it stopped
	.venv/bin/iphyre-jax world compare --weights iphyre_jax/models/world/weights

results-models: results-sequence results-world results-controllers results-language ## sequence models, world models, controllers, language models, one after the other

# The variable silences an announcement of the theme's makers; warnings still end the build.
docs: $(DOCS_VENV)/.stamp ## build the site of docs/ into build/site; it loads nothing from the network
	NO_MKDOCS_2_WARNING=1 $(DOCS_PY) -m mkdocs build --strict

$(DOCS_VENV)/.stamp: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(DOCS_VENV)
	$(DOCS_PY) -m pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[docs]'
	@touch $@

DOCS_PORT ?= 8765
SHOOT := $(or $(CHROMIUM),chromium) --headless --no-sandbox --disable-gpu --no-first-run --disable-background-networking \
	--disable-component-update --disable-sync --hide-scrollbars --window-size=1400,2400

docs-pictures: docs chromium ## pictures of the pages of the site in Chromium, in build/docs-pictures/
	rm -rf build/docs-pictures && mkdir -p build/docs-pictures
	$(DOCS_PY) -m http.server --bind 127.0.0.1 --directory build/site $(DOCS_PORT) >build/docs-pictures/server.log 2>&1 & \
	server=$$!; trap "kill $$server" EXIT; sleep 2; set -e; \
	for page in $$(cd build/site && find . -name '*.html' ! -name 404.html | sed 's|^\./||'); do \
		profile=$$(mktemp -d); \
		$(SHOOT) --user-data-dir=$$profile --screenshot=build/docs-pictures/$$(echo $${page%.html} | tr / -).png \
			http://127.0.0.1:$(DOCS_PORT)/$$page 2>>build/docs-pictures/chromium.log; \
		rm -rf $$profile; \
	done

bench: .venv/.stamp ## measure throughput and compile times
	$(PY) -m benchmarks

clean: ## remove .venv and build/, with it environments, caches and what the results targets have not published; runs/ stays
	rm -rf .venv build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis
