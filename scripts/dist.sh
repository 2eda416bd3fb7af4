#!/bin/sh
# Makes everything that a release consists of, in dist/: the stripped program as an archive and as a Debian package, its symbols, the clients'
# packages, the crate, the chart, a bill of materials, and checksums. BINARY names a program to pack (by default target/release/meshmend).
# Tools that are missing are installed with cargo, npm and pip.
set -eu

cd "$(dirname "$0")/.."
. scripts/packages.sh
target=${CARGO_TARGET_DIR:-target}
binary=${BINARY:-$target/release/meshmend}
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -n 1)
machine=$(uname -m)
stage=dist/stage
# The same commit gives the same files.
SOURCE_DATE_EPOCH=${SOURCE_DATE_EPOCH:-$(git log -1 --format=%ct 2>/dev/null || date +%s)}
export SOURCE_DATE_EPOCH

say() { printf 'dist: %s\n' "$*" >&2; }

archive() { tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$SOURCE_DATE_EPOCH" "$@"; }

cargo_tool() { command -v "$1" >/dev/null 2>&1 || { say "installing $1"; cargo install --quiet --locked "$1" --version "$2"; }; }

[ "$("$binary" --version 2>/dev/null)" = "meshmend $version" ] || { say "$binary is not meshmend $version: run \`make build\`"; exit 1; }
command -v strip >/dev/null 2>&1 || install_packages binutils || { say "binutils are missing"; exit 1; }
# cargo-deb asks dpkg-shlibdeps which libraries the program needs.
command -v dpkg-shlibdeps >/dev/null 2>&1 || install_packages dpkg-dev || { say "dpkg-dev is missing"; exit 1; }
mkdir -p dist
# `make image` writes there too.
find dist -mindepth 1 -maxdepth 1 ! -name '*-image*' -exec rm -rf {} +
mkdir -p $stage/man $stage/completions

say "the program"
strip -o $stage/meshmend "$binary"
objcopy --only-keep-debug --compress-debug-sections "$binary" "dist/meshmend-$version-$machine-linux.debug"
(cd $stage && objcopy --add-gnu-debuglink="../meshmend-$version-$machine-linux.debug" meshmend)
$stage/meshmend man $stage/man
$stage/meshmend completions bash > $stage/completions/meshmend.bash
$stage/meshmend completions zsh > $stage/completions/_meshmend
$stage/meshmend completions fish > $stage/completions/meshmend.fish
folder=meshmend-$version-$machine-linux
mkdir $stage/"$folder"
cp -r $stage/meshmend $stage/man $stage/completions README.md CHANGELOG.md LICENSE-MIT LICENSE-APACHE deploy/meshmend.service \
    deploy/meshmend.env.example $stage/"$folder"
archive -C $stage -cJf "dist/$folder.tar.xz" "$folder"

say "the Debian package"
cargo_tool cargo-deb 3.8.0
# A package installs into /usr, and has a user of its own.
sed -e 's|/usr/local/bin/|/usr/bin/|; s|^DynamicUser=yes|User=meshmend|' \
    -e '1,2c # systemd unit: one process with SQLite and a local folder, or with the database and S3 that /etc/meshmend/meshmend.env names.' \
    deploy/meshmend.service > $stage/meshmend.service
cargo deb --quiet --no-build --no-strip --no-dbgsym --output dist/

say "the clients"
if command -v npm >/dev/null 2>&1 || install_packages nodejs npm; then
    (cd clients/typescript && npm ci --silent --no-audit --no-fund >&2 && npm pack --silent --pack-destination ../../dist >&2)
else
    say "## npm is missing: there is no npm package ##"
fi
python3 -c 'import venv, ensurepip' 2>/dev/null || install_packages python3 python3-venv || { say "python3 with venv is missing"; exit 1; }
venv=$target/dist-maturin
[ -f "$venv/is-installed" ] || {
    rm -rf "$venv"
    python3 -m venv "$venv"
    "$venv/bin/python" -m pip install --quiet --disable-pip-version-check --only-binary=:all: maturin==1.16.0
    touch "$venv/is-installed"
}
# The engine is inside the wheel, so this builds it once more.
for verb in "build --release --locked --interpreter python3 --target-dir $target" sdist; do
    # shellcheck disable=SC2086
    "$venv/bin/maturin" $verb --manifest-path clients/python/Cargo.toml --out dist >"$target/dist.log" 2>&1 || { cat "$target/dist.log" >&2; exit 1; }
done

say "the crate"
cargo package --quiet --locked --no-verify --allow-dirty --target-dir $stage/crate
cp $stage/crate/package/*.crate dist/

say "the chart"
mkdir $stage/chart
cp -r deploy/helm/meshmend $stage/chart/
archive -C $stage/chart -c meshmend | gzip -n > "dist/meshmend-chart-$version.tgz"

say "the bill of materials"
cargo_tool cargo-cyclonedx 0.5.9
cargo cyclonedx --quiet --format json --spec-version 1.5 --features service --target "$machine-unknown-linux-gnu" --override-filename meshmend-sbom
mv meshmend-sbom.json "dist/meshmend-$version.cdx.json"

rm -rf $stage
sums=$(cd dist && find . -type f ! -name '*-image*' -printf '%P\n' | sort | xargs sha256sum)
printf '%s\n' "$sums" > dist/SHA256SUMS
say "the files in dist/:"
ls -sh1 dist >&2
