# Read in by scripts that try the program as a user would.

# Sets MESHMEND_PROGRAM to the program that the tests use, unless it is set, and builds it. A plain `cargo build` would compile all dependencies
# once more, because the tests' own dependencies add features to them.
build_program() {
    [ -z "${MESHMEND_PROGRAM:-}" ] || return 0
    cargo test --locked --quiet --features failpoints --test cli --no-run
    MESHMEND_PROGRAM=$(cd "${CARGO_TARGET_DIR:-target}" && pwd)/debug/meshmend
}
