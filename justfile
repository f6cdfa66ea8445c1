# All scripts of the project by name: `just --list`. Each can be started without just, too.

# the main job on the built-in segment
run *arguments:
    cargo run --release --locked -- {{arguments}}

# everything that needs no root and no network interface
test *arguments:
    cargo test --locked {{arguments}}

# what needs root, network interfaces and the machine's clock: real wires
wire *arguments:
    tests/wire.sh {{arguments}}

# the test command on slow, stalled, busy and poor machines; by default each once
machines *arguments:
    tests/machines.sh {{arguments}}

# tests with random inputs, with a seed that nobody has seen
random *arguments:
    tests/random.sh {{arguments}}

# all that a change must pass, as the server does it
ci:
    .ci/run

# format, lints, documentation
lint:
    cargo fmt --all --check
    cargo clippy --workspace --all-targets --locked -- -D warnings
    RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps --locked

# golden files, schemas and generated documents anew; read the diff
golden *tests:
    UPDATE_GOLDEN=1 UPDATE_SCHEMA=1 UPDATE_FINDINGS=1 UPDATE_HEADER=1 cargo test --locked {{tests}}

# instructions of the main paths against their table
instructions:
    benches/instructions.sh --check

# benchmarks
bench *arguments:
    cargo bench --locked {{arguments}}

# the pages of docs/ as a book, in target/book
book:
    .ci/book

# the simulator as a page for browsers
playground:
    .ci/playground

# the library for Python: wheel, types, tests, notebook
python:
    .ci/python

# firmware of the SubDevice stack, in an emulator
firmware:
    .ci/firmware

# each fuzz target for some seconds
fuzz seconds="10":
    .ci/fuzz {{seconds}}

# licences, sources and advisories of dependencies
deny:
    .ci/deny licences
    .ci/deny advisories

# Debian package and what else a release has, tried in a system of its own
package:
    .ci/package

# each package as the registry would get it
publish-check:
    .ci/publish
