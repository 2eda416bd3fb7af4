# Read in by scripts that may need packages of the distribution; `say` is theirs.

# install_packages NAME...: fails where that can't be done.
install_packages() {
    if [ "$(id -u)" = 0 ]; then
        run="env"
    elif command -v sudo >/dev/null 2>&1; then
        run="sudo env"
    else
        return 1
    fi
    command -v apt-get >/dev/null 2>&1 || return 1
    say "installing: $*"
    # The words of $run are meant to be split.
    # shellcheck disable=SC2086
    { $run apt-get update -qq && $run DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@"; } >/dev/null 2>&1
}
