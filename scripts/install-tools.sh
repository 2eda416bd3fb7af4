#!/bin/sh
# Makes sure of what the build needs beside Rust: a C compiler, for the SQLite that is built in.
set -u

say() { printf 'install-tools: %s\n' "$*" >&2; }

if ! command -v cargo >/dev/null 2>&1; then
    say "cargo is missing: install Rust 1.95 or later first"
    exit 1
fi
if command -v cc >/dev/null 2>&1; then
    exit 0
fi
if [ "$(id -u)" = 0 ]; then
    run=""
elif command -v sudo >/dev/null 2>&1; then
    run="sudo"
else
    say "a C compiler is missing: install the package 'gcc'"
    exit 1
fi
say "installing the package 'gcc'"
$run apt-get update -qq && $run env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq gcc libc6-dev >/dev/null
