#!/bin/sh
# Checks docs/design/queue.pml with Spin: it holds, and it fails without each guard. Installs the packages spin and gcc if they are missing.
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
model=$PWD/docs/design/queue.pml

say() { printf 'check-model: %s\n' "$*" >&2; }
fail() { say "FAILED: $*"; exit 1; }

for tool in spin gcc; do
    command -v $tool >/dev/null 2>&1 || install_packages spin gcc libc6-dev || fail "$tool is missing"
done
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

# Explores the model with an option for Spin and prints the numbers of errors and of states. Sets `errors`.
explore() {
    rm -f pan pan.* result
    # No option is no argument.
    # shellcheck disable=SC2086
    spin -a $1 "$model" >/dev/null || fail "spin can't read $model"
    gcc -O2 -DSAFETY -DCOLLAPSE -DMEMLIM=8000 -o pan pan.c || fail "the verifier can't be compiled"
    ./pan -m2000000 -w24 -n > result || fail "the verifier stopped: $(tail -n 1 result)"
    ! grep -qi 'max search depth too small\|out of memory' result || fail "not all states were visited"
    errors=$(sed -n 's/.*errors: \([0-9]*\).*/\1/p' result)
    [ -n "$errors" ] || fail "the verifier printed no result"
    echo "$errors errors"
    sed -n 's/^ *\([0-9.e+]*\) states, stored.*/\1 states/p' result
}

for guard in NO_TOKEN NO_FENCE NO_LEASE_CHECK NO_ATOMIC_CLAIM NO_OUTBOX NO_REPEAT; do
    echo "without a guard (-D$guard):"
    explore "-D$guard"
    [ "$errors" != 0 ] || fail "the model must fail without this guard"
done
echo "with all guards:"
explore ""
[ "$errors" = 0 ] || fail "the model does not hold"
