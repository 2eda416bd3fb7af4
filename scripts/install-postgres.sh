#!/bin/sh
# Makes sure of PostgreSQL's server binaries, from which the tests make clusters of their own. No cluster of the system's is made
# or started.
set -u

say() { printf 'install-postgres: %s\n' "$*" >&2; }

for initdb in /usr/lib/postgresql/*/bin/initdb "$(command -v initdb 2>/dev/null)"; do
    if [ -n "$initdb" ] && [ -x "$initdb" ]; then
        exit 0
    fi
done
if [ "$(id -u)" = 0 ]; then
    run="env"
elif command -v sudo >/dev/null 2>&1; then
    run="sudo env"
else
    say "PostgreSQL's server is missing: install the package 'postgresql', or run this as root"
    exit 1
fi
if ! command -v apt-get >/dev/null 2>&1; then
    say "PostgreSQL's server is missing: install it"
    exit 1
fi
say "installing the package 'postgresql'"
# The package would make a cluster and start it.
conf=/etc/postgresql-common/createcluster.conf
[ -e "$conf" ] || $run sh -c "mkdir -p ${conf%/*} && echo 'create_main_cluster = false' > $conf"
install="$run DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends -o Dpkg::Options::=--force-confold postgresql"
$install >/dev/null 2>&1 || { $run apt-get update -qq >/dev/null && $install >/dev/null; } || {
    say "the package 'postgresql' could not be installed"
    exit 1
}
