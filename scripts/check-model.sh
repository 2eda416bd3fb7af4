#!/bin/sh
# Checks docs/design/queue.pml with Spin: it holds, and it fails without each guard. Needs the packages spin and gcc.
set -eu
model=$(cd "$(dirname "$0")/.." && pwd)/docs/design/queue.pml
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

# Prints the number of errors and of states.
check() {
    spin -a $1 "$model"
    gcc -O2 -DSAFETY -DCOLLAPSE -DMEMLIM=8000 -o pan pan.c
    ./pan -m2000000 -w24 -n > result
    sed -n 's/.*errors: \([0-9]*\).*/\1 errors/p; s/^ *\([0-9.e+]*\) states, stored.*/\1 states/p' result
    grep -q 'errors: 0' result
}

for guard in NO_TOKEN NO_FENCE NO_LEASE_CHECK NO_ATOMIC_CLAIM NO_OUTBOX NO_REPEAT; do
    echo "without a guard (-D$guard):"
    if check "-D$guard"; then
        echo "the model must fail without this guard" >&2
        exit 1
    fi
done
echo "with all guards:"
check ""
