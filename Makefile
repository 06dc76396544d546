# Each target sets up its own requirements. Only the tools that `make check-tools` lists
# have to be installed by hand.

SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

CARGO  ?= cargo
PYTHON ?= python3
VENV   := .venv
PY     := $(VENV)/bin/python
TARGET := $(abspath $(or $(CARGO_TARGET_DIR),target))
BIN    := $(TARGET)/release/hullcast
LAB    := $(TARGET)/release/lab
CLIENT := $(wildcard client/pyproject.toml)

# The path at which the Python package finds the server, and that at which its tests find the laboratory.
export HULLCAST_BIN := $(BIN)
export HULLCAST_LAB := $(LAB)
export PIP_DISABLE_PIP_VERSION_CHECK := 1
export PIP_NO_INPUT := 1

.PHONY: help
help: ## prints this list
	@grep -hE '^[a-z0-9-]+:.*## ' $(MAKEFILE_LIST) | sort | awk -F':.*## ' '{printf "  make %-15s %s\n", $$1, $$2}'

.PHONY: demo
demo: check-tools build $(VENV)/.demo ## starts a server, computes the contacts of real scenes on it, and draws a picture
	$(PY) examples/demo.py

.PHONY: test
test: check-tools test-rust test-abuse-short $(if $(CLIENT),test-python) ## runs every test, Rust and Python

.PHONY: check-tools
check-tools: ## lists the tools that are missing on this machine
	@CARGO="$(CARGO)" PYTHON="$(PYTHON)" PATH="$(TOOLS)/bin:$$PATH" ./scripts/check-tools $(NEEDS)

# The tools that single targets need in addition. `check-tools` runs before anything is built, names
# each missing tool with the way to install it, and fails. With AVAILABLE=1 a target does what is
# possible on this machine, and prints what it leaves out.
lint: NEEDS := $(if $(AVAILABLE),,rustfmt clippy cxx deny)
playground: NEEDS := npm
test-playground: NEEDS := chromium $(if $(AVAILABLE),,npm)
test-tools test-contract: NEEDS := go
test-balancers: NEEDS := root ip haproxy nginx
test-deploy: NEEDS := $(if $(AVAILABLE),,go)
test-image: NEEDS := $(if $(AVAILABLE),,root runc systemd-analyze)
release-check: NEEDS := $(if $(AVAILABLE),,go root runc systemd-analyze)
test-faults: NEEDS := root
capacity: NEEDS := unshare ip
bench-counts: NEEDS := valgrind
fuzz fuzz-planted: NEEDS := nightly cargo-fuzz cxx
fuzz fuzz-planted: check-tools
test-extras types bench-ray simulators test-lowest test-latest: NEEDS := python3.11
test-languages: override LANGUAGES += $(if $(AVAILABLE),--available)

# These targets fail if one of their tests is skipped, because its subject is then missing.
test-extras test-playground test-s3 test-otlp test-deploy test-image test-balancers test-tools release-check: \
  export PYTEST_ADDOPTS := $(if $(AVAILABLE),,--no-skips)

# The schema of KEDA's resource is a file of its Go module.
KEDA := github.com/kedacore/keda/v2@v2.21.0
KEDA_SCHEMA := out/keda.sh_scaledobjects.yaml
$(KEDA_SCHEMA):
	mkdir -p out
	cp "$$(go mod download -json $(KEDA) | sed -n 's/^.*"Dir": "\(.*\)".*$$/\1/p')/config/crd/bases/$(@F)" $@

.PHONY: build
build: check-tools ## builds the server, target/release/hullcast
	$(CARGO) build --release --locked

# It names the whole workspace, so that cargo does not compile the dependencies again with other features.
.PHONY: lab
lab: check-tools ## builds the laboratory, target/release/lab, which measures without a server
	$(CARGO) build --release --locked --workspace --bin lab

# Separate from `test`, because a user's tests must not fail with another version of rustfmt
# or clippy. A distribution's cargo may come without these tools.
.PHONY: lint
lint: check-tools $(if $(CLIENT),lint-python) ## runs rustfmt, clippy, ruff and the check of the prose; warnings are errors
	@if $(CARGO) fmt --version >/dev/null 2>&1; then set -x; $(CARGO) fmt --all --check; cd benches; $(CARGO) fmt --check; cd ../fuzz; $(CARGO) fmt --check; \
	 else echo "rustfmt is not installed: formatting not checked"; fi
	@if $(CARGO) clippy --version >/dev/null 2>&1; then set -x; \
	 $(CARGO) clippy --release --locked --workspace --all-targets -- -D warnings; \
	 $(CARGO) clippy --release --locked --workspace -- -D warnings; \
	 $(CARGO) clippy --release --locked --all-targets --package hullcast --no-default-features -- -D warnings; \
	 cd benches; $(CARGO) clippy --release --locked --all-targets --features service -- -D warnings; \
	 else echo "clippy is not installed: lints not checked"; fi
	@if $(CARGO) clippy --version >/dev/null 2>&1 && command -v c++ >/dev/null; then set -x; cd fuzz; \
	 $(CARGO) clippy --release --locked --all-targets --no-default-features -- -D warnings; \
	 else echo "no clippy, or no C++ compiler: fuzz targets not checked"; fi
	@if git rev-parse HEAD >/dev/null 2>&1; then git apply --check fuzz/planted/*.patch; $(PYTHON) scripts/plain-english; fi
	@if PATH="$(TOOLS)/bin:$$PATH" cargo-deny --version >/dev/null 2>&1; then \
	 PATH="$(TOOLS)/bin:$$PATH" $(CARGO) deny --offline check --hide-inclusion-graph licenses bans sources; \
	 elif $(PYTHON) -c 'import tomllib' 2>/dev/null; then CARGO="$(CARGO)" $(PYTHON) scripts/licences; \
	 else echo "neither cargo-deny (make audit does it) nor Python 3.11: licences not checked"; fi

# Tools that are built when first needed. `make clean` keeps them.
TOOLS := $(HOME)/.cache/hullcast-tools

.PHONY: audit
audit: check-tools ## checks licences, bans, sources and advisories of every dependency with cargo-deny
	PATH="$(TOOLS)/bin:$$PATH" cargo-deny --version >/dev/null 2>&1 || $(CARGO) install --locked --root "$(TOOLS)" cargo-deny
	PATH="$(TOOLS)/bin:$$PATH" $(CARGO) deny check --hide-inclusion-graph

.PHONY: licences
licences: check-tools ## writes docs/licences.md; run it after a change of the dependencies
	CARGO="$(CARGO)" $(PYTHON) scripts/licences --list

.PHONY: lint-python
lint-python: $(VENV)/.lint ## runs ruff
	cd client && ../$(VENV)/bin/ruff check && ../$(VENV)/bin/ruff format --check

.PHONY: types
types: $(VENV)/.extras ## runs pyright in strict mode
	cd client && ../$(VENV)/bin/pyright --pythonpath ../$(PY)

.PHONY: test-rust
test-rust: check-tools ## runs the Rust tests of every crate
	$(CARGO) test --release --locked --workspace

# More workers than the 2 cores of a small machine, because most tests wait for servers most of the time.
PYTEST_WORKERS ?= 3

.PHONY: test-python
test-python: build lab $(VENV)/.test ## runs the Python tests against the real server
	@# The test of the wheel links the program again while others run, so all of them start a copy of it.
	mkdir -p $(TARGET)/release/tested && cp $(BIN) $(TARGET)/release/tested/hullcast
	HULLCAST_BIN=$(TARGET)/release/tested/hullcast $(PY) -m pytest client --numprocesses $(PYTEST_WORKERS)

.PHONY: test-extras
test-extras: build $(VENV)/.extras ## runs the Python tests that need large packages (real robots, decomposition, rerun, ray, torch, jax, MuJoCo, Newton), then pyright
	$(PY) -m pytest client/tests/extras
	$(MAKE) types

.PHONY: wheel
wheel: check-tools $(VENV)/.test ## builds the Python package with the server in it, fully optimised: target/wheels
	cd client && ../$(PY) -m maturin build --profile dist --out $(TARGET)/wheels

.PHONY: test-versions
test-versions: test-lowest test-latest ## runs the Python tests with the oldest and with the newest allowed packages

.PHONY: test-lowest test-latest
test-lowest test-latest: test-%: build lab
	$(MAKE) VENV=$(VENV)-$* $(VENV)-$*/.$*
	$(VENV)-$*/bin/python -m pytest client -o norecursedirs= -k 'not ur5_in_pieces'

# Zig links for the C library of CentOS 7, whatever this machine has.
.PHONY: wheel-manylinux
wheel-manylinux: check-tools $(VENV)/.release ## builds the Python package for every Linux with glibc 2.17 or later: target/wheels
	cd client && PATH="$(abspath $(VENV))/bin:$$PATH" ../$(PY) -m maturin build --zig --compatibility manylinux_2_17 --profile dist --out $(TARGET)/wheels

.PHONY: sdist
sdist: check-tools $(VENV)/.test ## writes the source distribution of the Python package: target/wheels
	cd client && ../$(PY) -m maturin sdist --out $(TARGET)/wheels

.PHONY: package
package: check-tools wheel-manylinux sdist ## builds the parts of a release: the crates (each built from its package only), the wheel, the source distribution and the crates' licences
	$(CARGO) publish --dry-run --locked --workspace
	CARGO="$(CARGO)" $(PYTHON) scripts/licences --texts > $(TARGET)/wheels/THIRD-PARTY-LICENCES.txt

# Old files are removed first, because the tests take every file in the folder for a part of the release.
.PHONY: release-check
release-check: check-tools $(VENV)/.release ## builds and checks everything that a release ships, from a clean commit: versions, crates, wheel, source distribution, chart, image
	./scripts/release-check
	rm -rf $(TARGET)/wheels $(TARGET)/package
	$(MAKE) package build
	HULLCAST_WHEELS=$(TARGET)/wheels $(PY) -m pytest client/tests/extras/test_release.py
	$(MAKE) test-deploy test-image

.PHONY: bench
bench: check-tools build $(VENV)/.demo ## compares contacts with parry3d, then measures the server from Python; writes docs/performance.md
	cd benches && $(CARGO) run --release --locked --bin contact
	$(PY) client/examples/throughput.py | tee /dev/stderr | ./scripts/section docs/performance.md throughput -
	./scripts/headline

.PHONY: bench-python
bench-python: build $(VENV)/.bench ## measures the Python client's own cost, and coal and python-fcl on one scene; writes docs/performance.md
	$(PY) client/examples/overhead.py | tee /dev/stderr | ./scripts/section docs/performance.md python-overhead -
	$(PY) client/examples/peers.py | tee /dev/stderr | ./scripts/section docs/performance.md python-peers -

.PHONY: bench-find
bench-find: build $(VENV)/.test ## measures the cost of finding pairs, up to 100,000 bodies and 10,000 worlds; writes docs/find.md and its picture
	$(PY) client/examples/find.py --docs docs

.PHONY: bench-loops
bench-loops: build $(VENV)/.test ## measures a step of a simulation by query, find and sessions; writes docs/performance.md
	$(PY) client/examples/loops.py | tee /dev/stderr | ./scripts/section docs/performance.md loops -

TRADEOFF_PEERS := parry3d parry3d-f64 coal mujoco

.PHONY: tradeoff tradeoff-families tradeoff-scenes
tradeoff: tradeoff-families tradeoff-scenes ## plots speed against accuracy for every setting, and for parry3d, coal and MuJoCo; writes docs/tradeoff.md and its plots

tradeoff-families: TRADEOFF =
tradeoff-scenes: TRADEOFF = examples/scenes/panda.json examples/scenes/pile.json
tradeoff-families tradeoff-scenes: tradeoff-%: lab $(VENV)/.bench
	mkdir -p out
	$(LAB) tradeoff $(TRADEOFF) --ask out/$*-pairs.json
	cd benches && $(CARGO) run --release --locked --bin peer -- ../out/$*-pairs.json ../out/$*-peers
	$(PY) client/examples/tradeoff_peers.py out/$*-pairs.json --out out/$*-peers
	$(LAB) tradeoff $(TRADEOFF) $(TRADEOFF_PEERS:%=--peer out/$*-peers/%.json) --out out/tradeoff-$* | tee out/tradeoff-$*.txt
	$(PY) client/examples/tradeoff.py out/tradeoff-$*.json docs/tradeoff-$*.png
	./scripts/section docs/tradeoff.md $* out/tradeoff-$*.txt

.PHONY: planarity
planarity: lab $(VENV)/.planarity ## measures the patches of rounded shapes for each planarity of faces; writes docs/tradeoff.md and its picture
	mkdir -p out
	$(PY) client/examples/planarity_meshes.py out/meshes.json
	$(LAB) planarity out/meshes.json --out out/planarity.csv | tee out/planarity.txt
	./scripts/section docs/tradeoff.md planarity out/planarity.txt
	cp out/planarity.csv docs
	$(PY) client/examples/planarity.py docs/planarity.csv docs/planarity.svg

.PHONY: simulation
simulation: build $(VENV)/.test ## runs a rigid body simulation on several kinds of contacts; writes docs/simulation.md and its pictures
	$(PY) client/examples/simulation --docs docs

.PHONY: simulators
simulators: build $(VENV)/.extras ## runs scenes in MuJoCo and Newton on their own contacts and on hullcast's; writes docs/simulators.md
	$(PY) client/examples/simulators | tee /dev/stderr | ./scripts/section docs/simulators.md simulators -

.PHONY: bench-service
bench-service: check-tools build ## compares the server with an echo server for the same bytes; writes docs/performance.md
	cd benches && $(CARGO) run --release --locked --features service --bin transport

# As `make bench-versions BASELINE=path/to/hullcast`.
.PHONY: bench-versions
bench-versions: check-tools build ## compares this server with the one at BASELINE under the same load, both in turns
	cd benches && HULLCAST_BASELINE="$(abspath $(BASELINE))" $(CARGO) run --release --locked --features service --bin versions

.PHONY: bench-counts
bench-counts: check-tools ## compares the number of instructions with parry3d's by valgrind, for machines with noisy timings; writes docs/performance.md
	cd benches && $(CARGO) run --release --locked --bin counts

.PHONY: bench-growth
bench-growth: check-tools build $(VENV)/.demo ## measures the time by number of vertices, pairs, hulls and cores; writes docs/performance.md and its picture
	cd benches && $(CARGO) run --release --locked --features service --bin growth
	$(PY) benches/growth.py

.PHONY: bench-ray
bench-ray: build $(VENV)/.extras ## compares a batch job on ray with the same job in one process; writes docs/python/batch-jobs.md
	mkdir -p out
	$(PY) client/examples/ray_scenes.py | tee out/ray.txt
	./scripts/section docs/python/batch-jobs.md ray out/ray.txt

.PHONY: stubs
stubs: $(VENV)/.test ## generates the Python protobuf modules; run it after a change of proto/
	PY=$(PY) ./scripts/stubs

.PHONY: protocol
protocol: $(VENV)/.test ## generates docs/protocol.md; run it after a change of the comments of proto/
	$(PY) scripts/protocol-docs

.PHONY: playground
playground: $(VENV)/.test ## builds playground/dist; run it after a change of playground/ or proto/; needs npm
	cd playground && npm ci --silent && PROTOC="$(abspath $(PY)) -m grpc_tools.protoc" npm run --silent build

.PHONY: test-playground
test-playground: check-tools $(VENV)/.playground ## tests the playground on the wire and in Chromium, and compares its bundle with its sources; needs Chromium and npm
	$(CARGO) test --release --locked --package hullcast --test service browsers
	$(CARGO) build --release --locked
	$(PY) -m pytest client/tests/extras/test_playground.py

.PHONY: test-languages
test-languages: build $(VENV)/.test ## tests clients in Go, TypeScript, Java and C++ against the real server; with AVAILABLE=1 only those whose tools are installed
	$(PY) scripts/test-languages $(LANGUAGES)

S3S_FS := 0.14.0

.PHONY: test-s3
test-s3: $(VENV)/.s3 $(TOOLS)/s3s-fs-$(S3S_FS)/bin/s3s-fs ## tests replicas on two S3 servers with many kinds of faults; builds the server with S3 in target/s3
	$(CARGO) build --release --locked --package hullcast --features s3 --target-dir $(TARGET)/s3
	PATH="$(TOOLS)/s3s-fs-$(S3S_FS)/bin:$$PATH" HULLCAST_BIN=$(TARGET)/s3/release/hullcast $(PY) -m pytest client/tests/extras/test_s3.py

$(TOOLS)/s3s-fs-$(S3S_FS)/bin/s3s-fs:
	$(CARGO) install --locked --root $(TOOLS)/s3s-fs-$(S3S_FS) --features binary s3s-fs@$(S3S_FS)

.PHONY: lint-stores
lint-stores: check-tools ## runs clippy with the stores that are not in the default build: S3, GCS, Azure
	$(CARGO) clippy --release --locked --all-targets --package hullcast --features s3,gcs,azure -- -D warnings

.PHONY: test-otlp
test-otlp: $(VENV)/.otlp ## tests traces from Python through the server to a collector; builds the server with OTLP in target/otlp
	$(CARGO) build --release --locked --package hullcast --features otlp --target-dir $(TARGET)/otlp
	HULLCAST_BIN=$(TARGET)/otlp/release/hullcast $(PY) -m pytest client/tests/extras/test_otlp.py

.PHONY: capacity
capacity: build $(VENV)/.demo ## measures a replica's cost per pair, and the size of a cluster that follows from it; writes docs/capacity.md
	unshare --user --map-root-user --net env PATH="$$PATH:/usr/sbin" $(PY) scripts/capacity

# With AVAILABLE=1 and without Go, the chart's tests are skipped.
.PHONY: test-deploy
test-deploy: build $(VENV)/.deploy $(if $(shell command -v go),out/bin/helm $(KEDA_SCHEMA)) ## checks the Kubernetes manifests and the Helm chart against their schemas and the server; needs Go
	PATH="$(abspath out/bin):$$PATH" $(PY) -m pytest client/tests/extras/test_deploy.py

# As `make image FEATURES=s3`.
.PHONY: image
image: check-tools ## writes the container image as an OCI archive, without a container builder: out/hullcast-image.tar
	$(CARGO) build --profile dist --locked --package hullcast --features "$(FEATURES)"
	$(PYTHON) scripts/image --binary $(TARGET)/dist/hullcast

.PHONY: test-image
test-image: build $(VENV)/.test ## runs the container image under the restrictions of the systemd unit; needs root and runc
	$(PY) -m pytest client/tests/extras/test_image.py

.PHONY: test-balancers
test-balancers: build $(VENV)/.test ## kills, drains and cuts off three replicas under load, behind HAProxy, nginx and the client's own balancing; needs root
	$(PY) -m pytest -s client/tests/extras/test_balancers.py

.PHONY: test-tools
test-tools: build $(VENV)/.test out/bin/grpcurl out/bin/ghz ## runs the commands of docs/grpcurl.md with grpcurl and ghz; needs Go
	PATH="$(abspath out/bin):$$PATH" $(PY) -m pytest client/tests/extras/test_tools.py

.PHONY: test-contract
test-contract: check-tools out/bin/buf ## checks by buf that the contract keeps to the style and does not break its committed descriptor set; needs Go
	cd proto && ../out/bin/buf lint && ../out/bin/buf breaking --against hullcast.v1.binpb

out/bin/buf: MODULE := github.com/bufbuild/buf/cmd/buf@v1.75.0
out/bin/grpcurl: MODULE := github.com/fullstorydev/grpcurl/cmd/grpcurl@v1.9.3
out/bin/ghz: MODULE := github.com/bojand/ghz/cmd/ghz@v0.93.0
out/bin/helm: MODULE := helm.sh/helm/v4/cmd/helm@v4.3.1
out/bin/buf out/bin/grpcurl out/bin/ghz out/bin/helm:
	GOBIN=$(abspath out/bin) go install $(MODULE)

# The full workload has 12,000 pairs with exact answers; a subset is in tests/golden.
.PHONY: workload
workload: check-tools ## WORKLOAD=file: compares every pair of a workload file with its exact answer
	@test -n "$(WORKLOAD)" || { echo "make workload WORKLOAD=path/to/workload.bin"; exit 2; }
	$(CARGO) run --release --locked --package hullcast-contact --example workload -- "$(WORKLOAD)"

STABILITY := $(CARGO) test --release --locked --package hullcast-contact --test stability --

.PHONY: stability
stability: check-tools ## compares answers at numerical extremes with exact ones; writes docs/stability.md and its picture
	STABILITY="$(abspath docs)" PROVENANCE="$$(./scripts/provenance)" $(STABILITY) --ignored --nocapture the_whole_matrix_is_met
	@digest() { $(CARGO) test --locked --package hullcast-contact --test stability "$$@" -- --nocapture the_same_pairs_give_the_same_bits | grep '^digest'; }; \
	 debug=$$(digest); release=$$(digest --release); echo "debug: $$debug, release: $$release"; test "$$debug" = "$$release"

.PHONY: stability-long
stability-long: check-tools ## THOUSANDS=1000: checks that many thousand cases by their certificates, and a tenth of them exactly; writes docs/fuzzing.md; takes over an hour
	mkdir -p out
	$(STABILITY) --ignored --nocapture many_cases a_million_cases | tee out/stability-long.txt
	! grep '^test .*FAILED' out/stability-long.txt
	{ grep '^|' out/stability-long.txt; echo; grep 'cases by' out/stability-long.txt; } > out/stability-closing.txt
	./scripts/section docs/fuzzing.md long out/stability-closing.txt

# Needs root to mount a small disk, which is filled and made read-only.
.PHONY: test-faults
test-faults: check-tools ## tests kill -9 a thousand times, full and vanished disks, and torn blobs; needs root
	$(CARGO) test --release --locked --package hullcast --test faults -- --ignored --nocapture --test-threads 1

.PHONY: test-abuse test-abuse-short
test-abuse-short: check-tools ## runs the attacks over TCP at a tenth of their size against a tenth of the budgets; takes over a minute
	$(CARGO) test --release --locked --workspace --test abuse -- --skip over_tls --skip over_unix

test-abuse: check-tools ## runs every attack at full size on a server with default limits; writes docs/reliability.md; takes about ten minutes
	mkdir -p out
	$(CARGO) test --release --locked --workspace --test abuse -- --ignored --nocapture --test-threads 1 | tee out/abuse.txt
	{ echo '| attack | queries before, ms | queries during, ms | health before, ms | health during, ms | retries | peak, MiB | free after, s |'; \
	 echo '|---|---|---|---|---|--:|--:|--:|'; grep '^|' out/abuse.txt; } > out/abuse-table.txt
	./scripts/section docs/reliability.md abuse out/abuse-table.txt

FUZZ_SECONDS ?= 600

.PHONY: fuzz fuzz-report fuzz-planted
fuzz: ## runs each fuzz target for FUZZ_SECONDS (600); needs nightly Rust and cargo-fuzz
	./scripts/fuzz run --seconds $(FUZZ_SECONDS)

fuzz-report: ## reports the fuzzing on this machine (cases, hours, coverage); writes docs/fuzzing.md
	mkdir -p out
	./scripts/fuzz report | tee out/fuzz-report.txt
	./scripts/section docs/fuzzing.md report out/fuzz-report.txt

fuzz-planted: ## plants known faults one by one in a copy of the source; fuzzing must find each
	./scripts/fuzz planted --seconds $(FUZZ_SECONDS)

.PHONY: clean
clean: ## removes all built files
	rm -rf target benches/target $(VENV) $(VENV)-* out

# Runs Sphinx on the repository's own pages, and checks every link and reference.
.PHONY: docs
docs: $(VENV)/.docs ## builds the documentation site with the references of both libraries: out/site/README.html
	rm -rf out/site
	$(PY) -m sphinx --builder html --fail-on-warning --keep-going --quiet --conf-dir docs/site --doctree-dir out/doctrees . out/site
	RUSTDOCFLAGS="-D warnings -A rustdoc::private-intra-doc-links" $(CARGO) doc --locked --workspace --no-deps --lib
	cp -r $(TARGET)/doc out/site/rust

# The pinned Python packages. The client itself is used in place.
REQUIREMENTS := client/requirements.txt

$(VENV)/.demo: examples/requirements.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.test: client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.extras: client/requirements-extras.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.lowest $(VENV)/.latest: $(VENV)/.%: client/requirements-%.txt | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.deploy: client/requirements-deploy.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.release: client/requirements-release.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.otlp: client/requirements-otlp.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.s3: client/requirements-s3.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.playground: client/requirements-playground.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.bench: client/requirements-bench.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.planarity: client/requirements-planarity.txt client/requirements-dev.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.lint: client/requirements-lint.txt | check-tools
	$(call install,$<)
	touch $@

$(VENV)/.docs: docs/site/requirements.txt $(REQUIREMENTS) | check-tools
	$(call install,$<)
	touch $@

# If an earlier installation was interrupted, pip does not run: make the environment again.
define install
	$(PY) -m pip --version >/dev/null 2>&1 || { rm -rf $(VENV); $(PYTHON) -m venv $(VENV); }
	$(PY) -m pip install --quiet --requirement $(1)
	$(PY) -c 'import pathlib, sysconfig; pathlib.Path(sysconfig.get_path("purelib"), "hullcast-in-place.pth").write_text("$(abspath client/src)\n")'
endef
