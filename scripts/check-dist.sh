#!/bin/sh
# Installs and tries everything in dist/ that `make dist` made: the Debian package in an empty Debian root (mmdebstrap and chroot, so it needs
# root), the archive there too, the clients' packages in fresh environments against the program, the bill of materials and the crate.
# It prints the time from `apt install` to a repaired model, which must be under 30 s. WITH_BLENDER=1 first installs Blender, which the
# package recommends, and also repairs a model with it.
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
dist=$PWD/dist
target=${CARGO_TARGET_DIR:-target}
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
suite=${SUITE:-bookworm}

say() { printf 'check-dist: %s\n' "$*" >&2; }
fail() { say "FAILED: $*"; exit 1; }

[ "$(id -u)" = 0 ] || fail "a Debian root needs root: sudo make check-dist"
[ -f "$dist/SHA256SUMS" ] || fail "there is no dist/: run \`make dist\`"
for tool in mmdebstrap systemd-analyze; do
    command -v $tool >/dev/null 2>&1 || install_packages mmdebstrap systemd || fail "$tool is missing"
done

work=$(mktemp -d)
root=$work/root
server=
clean_up() {
    [ -z "$server" ] || kill "$server" 2>/dev/null || true
    for mounted in dev/pts dev proc; do
        umount "$root/$mounted" 2>/dev/null || true
    done
    rm -rf "$work"
}
trap clean_up EXIT

say "checksums"
(cd "$dist" && sha256sum --quiet --check SHA256SUMS)
listed=$(cut -d ' ' -f 3 "$dist/SHA256SUMS" | sort)
[ "$listed" = "$(cd "$dist" && find . -type f ! -name SHA256SUMS ! -name '*-image*' -printf '%P\n' | sort)" ] || fail "SHA256SUMS does not list all files"

say "an empty Debian root ($suite)"
mmdebstrap --quiet --variant=minbase --hook-dir=/usr/share/mmdebstrap/hooks/maybe-merged-usr --include=usr-is-merged \
    "$suite" "$root" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "mmdebstrap"; }
# The root is thrown away, so dpkg need not wait for the disk.
echo force-unsafe-io > "$root/etc/dpkg/dpkg.cfg.d/unsafe-io"
for mounted in proc dev dev/pts; do
    mount --bind "/$mounted" "$root/$mounted"
done
cp /etc/resolv.conf /etc/hosts "$root/etc/" 2>/dev/null || true
# A package must not start services here.
printf '#!/bin/sh\nexit 101\n' > "$root/usr/sbin/policy-rc.d"
chmod +x "$root/usr/sbin/policy-rc.d"
inside() { chroot "$root" env -i PATH=/usr/sbin:/usr/bin:/sbin:/bin HOME=/root DEBIAN_FRONTEND=noninteractive LC_ALL=C.UTF-8 "$@"; }
# A box with a hole in its bottom and one in its top.
printf '%s\n' OFF '8 10 0' '0 0 0' '9 0 0' '9 9 0' '0 9 0' '0 0 30' '9 0 30' '9 9 30' '0 9 30' '3 2 1 0' '3 4 5 6' \
    '3 0 1 5' '3 0 5 4' '3 1 2 6' '3 1 6 5' '3 2 3 7' '3 2 7 6' '3 3 0 4' '3 3 4 7' > "$root/root/broken.off"
repairs() {
    inside "$@" repair /root/broken.off -o /root/repaired.stl --report /root/report.json >/dev/null
    inside "$@" inspect /root/repaired.stl >/dev/null
    grep -q '"outcome": *"repaired"' "$root/root/report.json" || fail "the box was not repaired"
}
files() { inside find / -xdev \( -path /proc -o -path /dev -o -path /tmp -o -path /root -o -path /var/cache -o -path /var/log -o -path /var/lib/apt \
    -o -path /var/lib/dpkg \) -prune -o -print | sort; }

say "apt install ./meshmend_*.deb"
inside apt-get update -qq
# What the package needs stays, so that only its own files count.
inside apt-get install -y -qq --no-install-recommends systemd-standalone-sysusers libgcc-s1 ca-certificates >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "apt"; }
files > "$work/before"
cp "$dist"/meshmend_*.deb "$root/root/"
recommended=--no-install-recommends
now_ms() { echo $(($(date +%s%N) / 1000000)); }
if [ -n "${WITH_BLENDER:-}" ]; then
    recommended=
    inside apt-get install -y -qq --download-only blender >/dev/null 2>&1
    begun=$(now_ms)
    inside apt-get install -y -qq blender >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "apt"; }
    say "Blender from apt's cache, with its dependencies: $(($(now_ms) - begun)) ms"
fi
begun=$(now_ms)
# shellcheck disable=SC2086
inside sh -c "apt-get install -y -qq $recommended /root/meshmend_*.deb" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "apt"; }
repairs meshmend
took=$(($(now_ms) - begun))
say "from apt install to a repaired model${WITH_BLENDER:+, with Blender installed}: $took ms"
[ "$took" -lt 30000 ] || fail "that is more than 30 s"
[ "$(inside meshmend --version)" = "meshmend $version" ] || fail "the version is $(inside meshmend --version)"
if [ -n "${WITH_BLENDER:-}" ]; then
    inside meshmend repair /root/broken.off -o /root/remeshed.stl --preset blender-remesh --report /root/report.json >/dev/null
    grep -q '"action": *"voxel_remesh"' "$root/root/report.json" || fail "Blender did not run"
fi

say "the unit, the user, the settings"
# This machine's systemd looks at the unit, whose program is in the root.
sed "s|^ExecStart=/|ExecStart=$root/|" "$root/usr/lib/systemd/system/meshmend.service" > "$work/meshmend.service"
problems=$(systemd-analyze verify --man=no "$work/meshmend.service" 2>&1) || fail "$problems"
[ -z "$problems" ] || fail "$problems"
inside id meshmend >/dev/null || fail "there is no user meshmend"
owner() { inside stat -c '%U:%G %a' "$1"; }
[ "$(owner /etc/meshmend/meshmend.env)" = "root:root 600" ] || fail "meshmend.env is $(owner /etc/meshmend/meshmend.env)"
grep -qx /etc/meshmend/meshmend.env "$root/var/lib/dpkg/info/meshmend.conffiles" || fail "meshmend.env is no conffile"
# The unit's command with its environment, as its user.
inside install -d -o meshmend -g meshmend -m 0700 /var/lib/meshmend /run/meshmend
# shellcheck disable=SC2046
inside setpriv --reuid=meshmend --regid=meshmend --clear-groups env $(sed -n 's/^Environment=//p' "$root/usr/lib/systemd/system/meshmend.service") \
    "$(sed -n 's/^ExecStart=\([^ ]*\) .*/\1/p' "$root/usr/lib/systemd/system/meshmend.service")" keys create --tenant check >"$work/key" 2>"$work/log" ||
    { cat "$work/log" >&2; fail "keys create"; }
grep -q '^mm_key_' "$work/key" || fail "no key was created"

say "manual pages and completions"
for page in meshmend meshmend-repair meshmend-serve; do
    gzip -dc "$root/usr/share/man/man1/$page.1.gz" > "$work/page.1" || fail "there is no page $page(1)"
    grep -q '^\.SH NAME' "$work/page.1" || fail "$page(1) has no name"
    if command -v groff >/dev/null 2>&1; then
        problems=$(groff -man -Tutf8 -ww -z "$work/page.1" 2>&1)
        [ -z "$problems" ] || fail "$page(1): $problems"
    fi
done
inside bash -c '. /usr/share/bash-completion/completions/meshmend && complete -p meshmend' >/dev/null || fail "bash's completions"
for file in usr/share/zsh/vendor-completions/_meshmend usr/share/fish/vendor_completions.d/meshmend.fish; do
    grep -q inspect "$root/$file" || fail "$file"
done

say "apt remove and purge"
inside apt-get remove -y -qq meshmend >/dev/null 2>&1
if ! [ -f "$root/etc/meshmend/meshmend.env" ] || ! [ -d "$root/var/lib/meshmend" ]; then fail "remove deleted settings or jobs"; fi
inside apt-get purge -y -qq meshmend >/dev/null 2>&1
if [ -z "${WITH_BLENDER:-}" ]; then
    files > "$work/after"
    left=$(comm -13 "$work/before" "$work/after" | grep -Ev '^/run/|^/etc/(passwd|group|shadow|gshadow)-$' || true)
    [ -z "$left" ] || fail "purge leaves: $left"
fi

say "the archive"
folder=meshmend-$version-$(uname -m)-linux
tar -xf "$dist/$folder.tar.xz" -C "$root/root"
repairs "/root/$folder/meshmend"
if ! [ -f "$root/root/$folder/man/meshmend.1" ] || ! [ -f "$root/root/$folder/LICENSE-MIT" ]; then fail "the archive is incomplete"; fi
program=$work/meshmend
cp "$root/root/$folder/meshmend" "$program"
size=$(stat -c %s "$program")
say "the program: $((size / 1000000)) MB stripped"
[ "$size" -lt 50000000 ] || fail "the program is not stripped"
readelf --string-dump=.gnu_debuglink "$program" | grep -q "meshmend-$version-$(uname -m)-linux.debug" || fail "the program does not name its symbols"
build_id() { readelf --notes "$1" 2>/dev/null | sed -n 's/.*Build ID: //p'; }
[ "$(build_id "$program")" = "$(build_id "$dist/$folder.debug")" ] || fail "the symbols are another program's"

say "a service for the clients"
mkdir "$work/data"
MESHMEND_LISTEN=127.0.0.1:0 MESHMEND_BLENDER=/nonexistent "$program" serve --data-dir "$work/data" >/dev/null 2>"$work/service" &
server=$!
for _ in $(seq 100); do
    url=$(sed -n 's/.*listening on \(http:[^ ,]*\).*/\1/p' "$work/service" | head -n 1)
    [ -z "$url" ] || break
    sleep 0.1
done
[ -n "$url" ] || { cat "$work/service" >&2; fail "the service does not start"; }

say "the Python packages"
python3 -m venv "$work/venv"
"$work/venv/bin/python" -m pip install --quiet --disable-pip-version-check "$dist"/meshmend-"$version"-*.whl
(cd "$work" && "$work/venv/bin/python" -c "
import meshmend
result = meshmend.repair('$root/root/broken.off', output='stl', blender=False)
result.save('engine.stl')
assert result.is_printable and len(result.faces), result.summary
assert meshmend.__version__ == '$version', meshmend.__version__
") || fail "the engine of the wheel"
cmp -s "$work/engine.stl" "$root/root/repaired.stl" || fail "the wheel and the program give different files"
(cd "$work" && "$work/venv/bin/python" "$OLDPWD/clients/python/examples/repair.py" "$url" "$root/root/broken.off" python.stl | grep -q '^repaired: ') ||
    fail "the client of the wheel"
# A build from the sources takes as long as the program's, so only the contents are checked.
tar -tzf "$dist/meshmend-$version.tar.gz" > "$work/sources"
for file in pyproject.toml Cargo.lock rust/lib.rs src/meshmend/__init__.py src/meshmend/py.typed src/repair/pipeline.rs; do
    grep -q "/$file\$" "$work/sources" || fail "the Python sources have no $file"
done

say "the npm package"
mkdir "$work/npm"
cp clients/typescript/examples/repair.mjs "$work/npm/"
(cd "$work/npm" && npm init --yes >/dev/null && npm install --silent --no-audit --no-fund "$dist"/meshmend-client-"$version".tgz &&
    node repair.mjs "$url" "$root/root/broken.off" node.stl | grep -q '^repaired: ' &&
    grep -q customElements "$(node --print 'require.resolve("meshmend-client/widget")')") || fail "the npm package"

say "the bill of materials"
[ -f "$target/sbom-venv/is-installed" ] || {
    python3 -m venv "$target/sbom-venv"
    "$target/sbom-venv/bin/python" -m pip install --quiet --disable-pip-version-check 'cyclonedx-python-lib[json-validation]==11.12.0'
    touch "$target/sbom-venv/is-installed"
}
"$target/sbom-venv/bin/python" - "$dist/meshmend-$version.cdx.json" <<'PY'
import json
import sys

from cyclonedx.schema import SchemaVersion
from cyclonedx.validation.json import JsonStrictValidator

text = open(sys.argv[1], encoding="utf-8").read()
error = JsonStrictValidator(SchemaVersion.V1_5).validate_str(text)
if error is not None:
    sys.exit(str(error))
names = {component["name"] for component in json.loads(text)["components"]}
assert {"tokio", "sqlx", "rayon"} <= names and "proptest" not in names, len(names)
PY

say "the crate"
tar -tzf "$dist/meshmend-$version.crate" > "$work/crate"
for file in Cargo.toml README.md LICENSE-MIT LICENSE-APACHE src/lib.rs src/web/dist/index.html docs/README.md; do
    grep -qx "meshmend-$version/$file" "$work/crate" || fail "the crate has no $file"
done
! grep -E "^meshmend-$version/(benches|clients|fuzz|target|tests|src/web/page)/|node_modules" "$work/crate" || fail "the crate has files of the repository alone"

say "all is well"
