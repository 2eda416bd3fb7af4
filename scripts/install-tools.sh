#!/bin/sh
# Makes sure of what is needed beside Rust: a C compiler for the SQLite that is built in, and curl, with which the tests
# run the README's example.
set -u

say() { printf 'install-tools: %s\n' "$*" >&2; }

if ! command -v cargo >/dev/null 2>&1; then
    say "cargo is missing: install Rust 1.95 or later first"
    exit 1
fi
packages=""
command -v cc >/dev/null 2>&1 || packages="$packages gcc libc6-dev"
command -v curl >/dev/null 2>&1 || packages="$packages curl"
if [ -z "$packages" ]; then
    exit 0
fi
if [ "$(id -u)" = 0 ]; then
    run="env"
elif command -v sudo >/dev/null 2>&1; then
    run="sudo env"
else
    say "please install:$packages"
    exit 1
fi
say "installing:$packages"
# The words of $run and $packages are meant to be split.
# shellcheck disable=SC2086
$run apt-get update -qq && $run DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $packages >/dev/null
