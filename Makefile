# biobot: the base station for cyborg-insect networks. "make help" lists what there is.
.DEFAULT_GOAL := help
VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed
PEERS := .venv-peers
WIRE_PEERS := .venv-wire-peers
FUZZ := .venv-fuzz
ARGS ?=
export PREFIX DESTDIR SERVICES

help:  ## list the targets
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## (.*)/  make \1\t\2/' | expand -t 26

venv: $(STAMP)  ## make .venv with everything, pinned and hashed; every console script runs from it
SOURCES := $(wildcard simulator/engine/*.[ch] mapper/kernels/*.[ch] gateway/bulk/*.c firmware_protocol/c/*.[ch] firmware_protocol/c/bulk/*.[ch])
$(STAMP): pyproject.toml requirements/dev.txt requirements/build.txt scripts/bootstrap.sh scripts/install.sh scripts/compiler.sh hatch_build.py $(SOURCES)
	sh scripts/compiler.sh
	sh scripts/install.sh $(VENV) requirements/dev.txt
	$(PY) -m pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps --editable .
	-$(PY) -m mapper warm-up --quiet
	touch $(STAMP)

demo: venv  ## insects walk, a gateway listens, a mapper draws; the map opens in a browser (ARGS="--exit --seed 7")
	$(PY) -m studies.demo $(ARGS)

test: venv  ## run the tests (ARGS="-k name")
	$(PY) -m pytest --numprocesses=3 --dist=loadgroup $(ARGS)

test-campaigns: venv  ## run the tests that are studies in small, which `make test` leaves out (minutes; docs/testing.md)
	$(PY) -m pytest --numprocesses=2 --dist=loadgroup -m campaign $(ARGS)

story: venv  ## an operator's whole story at the page, over real processes, with pictures of each step in artifacts/ (minutes)
	$(PY) -m pytest -n0 -m story tests/e2e/test_story.py $(ARGS)

check: venv format-check lint types layers test  ## the gate: format, lint, types, layers, tests

format:  ## write the format
	$(PY) -m ruff format . && $(PY) -m ruff check --fix .

format-check: venv
	$(PY) -m ruff format --check .

lint: venv
	$(PY) -m ruff check .

types: venv
	$(PY) -m mypy

layers: venv
	$(VENV)/bin/lint-imports

system-packages:  ## install what some tests want: Chromium, compilers and emulators for other processors (Debian)
	sh scripts/system_packages.sh

train: venv  ## train the hole classifier anew on simulated arenas (hours; resumable)
	$(PY) -m studies.train_classifier $(ARGS)

train-confidence: venv  ## train how sure a map is anew (minutes; resumable), after `make train`
	$(PY) -m studies.train_confidence --out mapper/data/confidence.json $(ARGS)

sweep: venv  ## simulate and map over a grid of parameters (resumable; ARGS="studies/data/recipes.toml --csv out.csv")
	$(PY) -m studies.sweep $(ARGS)

paper: venv  ## every experiment of the paper: figures, data and the tables of docs/paper.md (an hour; resumable; ARGS="--jobs 1")
	$(PY) -m studies.paper --changed recompute $(ARGS) && $(PY) -m studies.paper.report

theory: venv  ## compare motion, meetings and walls with theory, and encounters with brute force (minutes)
	$(PY) -m studies.motion_theory $(ARGS) && $(PY) -m studies.encounter_check

bench-sim: venv  ## how fast the simulator is on one core, beside Mesa (minutes)
	$(PY) -m studies.bench_sim $(ARGS)

bench-map: venv  ## how fast maps are made, beside the plain ways, and persistence beside its peers (ten minutes; ARGS="--quick")
	$(PY) -m studies.bench_map $(ARGS)
	$(MAKE) bench-rips ARGS=

bench-rips: venv  ## Rips persistence beside GUDHI, ripser.py and giotto-ph, in an environment of its own (a minute)
	sh scripts/install.sh $(PEERS) requirements/dev.txt requirements/peers.txt
	$(PEERS)/bin/python -m studies.bench_rips $(ARGS)

wire-peers:  ## make .venv-wire-peers with zigpy-znp and zigpy-xbee (GPL), which tests run as programs of their own
	sh scripts/install.sh $(WIRE_PEERS) requirements/wire-peers.txt

bench-live: venv  ## 2,000 encounters/s into a store of 500,000: age of the map, the API, the gateway, losses, restart (minutes)
	$(PY) -m studies.bench_live $(ARGS)

bench-rest: venv  ## GET /api/v1/map beside a bare route of the same bytes, its latency under load, 200 event streams (minutes; ARGS="--minutes 10")
	$(PY) -m studies.rest_speed $(ARGS)

bench-page: venv  ## how long frames of the page are, with 500 rows that all change and with large maps (a browser; minutes; docs/page.md)
	$(PY) -m studies.page_speed $(ARGS)

soak: venv  ## hours of radios that fail now and then: does memory grow, do descriptors or threads? (docs/soak.md; ARGS="--hours 2")
	$(PY) -m studies.soak $(ARGS)

rest-campaign: venv  ## 20,000 generated requests to the mapper's API: what its OpenAPI document says must hold (minutes; docs/rest-campaign.md; ARGS="--cases 2000")
	$(PY) -m studies.rest_campaign $(ARGS)

clocks: venv  ## times of encounters and their bounds against the truth: drift, queues, restarts, lost beacons (half a minute)
	$(PY) -m studies.clocks $(ARGS)

bench-gateway: venv  ## encounters through a gateway with eight dongles under load: how many, at what cost, how late (minutes; ARGS="--encounters 1e7")
	$(PY) -m studies.bench_gateway $(ARGS)

bench-stop: venv  ## how soon a stop has left for the dongle, by every way, under load, with a full disk (root for that; minutes; docs/stop.md)
	$(PY) -m studies.stop_latency $(ARGS)

campaign: venv  ## a whole site lives through 1,000 faults; is every one of 1,000,000 encounters in the store? (an hour; resumable; docs/campaign.md)
	$(PY) -m studies.campaign $(ARGS)

cut-links: venv  ## cut cables, drop packets, kill the router: how soon is the mapper's store complete again? (root; a minute; docs/zenoh.md)
	$(PY) -m studies.cut_links $(ARGS)

sites: venv  ## three gateways, two routers, a mapper and a second site in namespaces: cut, healed, moved, accounted for (root; minutes; docs/sites.md)
	$(PY) -m studies.sites $(ARGS)

bench-sites: venv  ## what an encounter, a biobot and a base station cost gateway, routers and mapper (root; minutes; docs/scaling.md)
	$(PY) -m studies.sites.costs $(ARGS)

bench-dead-man: venv  ## kill a commander, cut its link: how soon do those that it moves stand? (links as root; minutes; docs/steering.md)
	$(PY) -m studies.dead_man $(ARGS)

gate-histories: venv  ## 100,000 random histories of the stimulation gate: is a limit ever exceeded at an electrode? (docs/gate-histories.md; ARGS="--histories 1000")
	$(PY) -m studies.gate_histories --out artifacts/gate-histories.jsonl $(ARGS)

campaign-walls: venv  ## no insect leaves its arena in 10^9 steps of nasty arenas (an hour; resumable; ARGS="--steps 1e7")
	$(PY) -m studies.wall_campaign $(ARGS)

check-kernels: venv  ## the mapper's tests of kernels once more, under the address and undefined-behaviour sanitizers (a minute)
	$(PY) scripts/check_kernels.py $(ARGS)

hil: venv  ## check what is plugged in, capability by capability (PORT=/dev/serial/by-id/... ARGS="--dialect xbee")
	@test -n "$(PORT)" || { echo 'name what is plugged in: make hil PORT=/dev/serial/by-id/...; biobot-gateway list-ports shows what there is' >&2; exit 2; }
	$(PY) -m gateway check-radio "$(PORT)" $(ARGS)

generate-c: venv  ## write the C side's layouts from firmware_protocol/layouts.py
	$(PY) scripts/generate_c.py

check-c: venv  ## compile the C side for this machine, Cortex-M and 8051 without a warning; print code and RAM (docs/firmware.md)
	$(PY) scripts/generate_c.py --check
	$(PY) scripts/firmware_size.py $(ARGS)

resync: venv  ## how many sound frames the damage of others costs, beside other libraries (half a minute; wants make wire-peers)
	$(PY) -m studies.resync $(ARGS)

bench-wire: venv  ## how fast frames are decoded, beside other libraries (a minute; wants make wire-peers)
	$(PY) -m studies.bench_wire $(ARGS)

fuzz-wire:  ## fuzz all that reads from a line, guided by coverage (docs/wire-fuzz.md; hours; ARGS="--inputs 10000000")
	sh scripts/bootstrap.sh $(FUZZ)
	$(FUZZ)/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes -r requirements/dev.txt -r requirements/fuzz.txt
	$(FUZZ)/bin/python -m studies.fuzz_wire $(ARGS)

fuzz-both: venv  ## ask Python and C the same of millions of inputs (docs/wire-fuzz.md; ARGS="--inputs 10000000")
	$(PY) -m studies.wire_differences $(ARGS)

firmware-image: venv  ## build the coordinator firmware for an emulated board and for the CC2530 (needs their compilers: make system-packages)
	$(PY) scripts/build_firmware.py $(ARGS)

fuzz-c: venv  ## throw inputs at the C side under sanitizers (needs clang; half a minute; ARGS="--inputs 10000000" for the campaign)
	$(PY) scripts/fuzz_c.py $(ARGS)

pictures: venv  ## make the pictures of the documents anew (minutes; wants Chromium: make system-packages; ARGS="--only-drawn")
	$(PY) -m studies.pictures $(ARGS)

lock:  ## pin every dependency with hashes (needs uv)
	sh scripts/lock.sh

docker-check: venv  ## lint the Dockerfile and validate the compose files; no engine needed
	$(VENV)/bin/hadolint -c docker/hadolint.yaml docker/Dockerfile
	$(VENV)/bin/check-jsonschema --builtin-schema vendor.compose-spec docker/compose.yaml docker/compose.site.yaml

containers: venv  ## build the images and run both compose files with buildah and podman (root; minutes; docs/containers.md; ARGS="--skip")
	$(PY) -m scripts.containers $(ARGS)

bare-machine:  ## demo and tests on a Debian made by debootstrap, with python3, make, gcc and git alone (root; docs/bare-machine.md; ARGS="--no-tests")
	python3 -m scripts.bare_machine $(ARGS)

install:  ## install this checkout as services of the machine, or upgrade them (root; PREFIX, DESTDIR, SERVICES=gateway,mapper,router; docs/installing.md)
	sh scripts/services.sh install $(ARGS)

uninstall:  ## remove them; data and configurations stay (ARGS="--purge --yes": those go too)
	sh scripts/services.sh uninstall $(ARGS)

install-check: venv  ## install, upgrade, break and remove the services on a machine of their own: systemd in a container (root, podman; minutes)
	$(PY) -m scripts.installed $(ARGS)

deploy-check: venv  ## check the systemd units and udev rules with systemd's own tools
	$(PY) scripts/deploy_check.py

sbom: venv  ## write the bill of materials, CycloneDX (dist/biobot-VERSION.cdx.json; ARGS="--shipped")
	$(PY) -m scripts.release.sbom $(ARGS)

bundle: venv  ## make the archive that installs where there is no network (docs/bundle.md; minutes; ARGS="--python 3.11 --machine aarch64")
	$(PY) -m scripts.release.bundle $(ARGS)

bundle-check: venv  ## install dist's bundle without a network, map and run the demo, for each Python here (minutes; ARGS="--tree build/trees/debian-14")
	$(PY) -m scripts.release.bundle_check $(ARGS)

reproducible: venv  ## make what is released twice, in other folders, with another umask, clock, language; it has to be the same to the octet (ARGS="--bundle")
	$(PY) -m scripts.release.reproducible $(ARGS)

wheels-check: venv  ## install wheel and sdist into bare environments, and map, for each Python here (minutes; docs/releasing.md)
	$(PY) -m scripts.release.wheels_check $(ARGS)

formats: venv  ## keep the files that this version leaves behind, for tests of later ones (once a release; docs/formats.md)
	$(PY) -m scripts.release.freeze_formats $(ARGS)

clean:  ## remove what the other targets made
	rm -rf $(VENV) $(PEERS) $(FUZZ) fuzz-out $(WIRE_PEERS) simulator/engine/*.so mapper/kernels/*.so gateway/bulk/*.so build dist demo-out campaign-out bench-live-out rest-speed-out page-speed-out sites-out bench-gateway-out soak-out artifacts .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache

.PHONY: $(shell sed -nE 's/^([a-z-]+):( .*)?$$/\1/p' $(MAKEFILE_LIST))
