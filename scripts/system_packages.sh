#!/bin/sh
# Installs what scripts/packages.txt lists and this computer lacks: as root with apt. Otherwise names it in one line.
# Never fails: the tests that need a missing package are skipped and counted by name (or fail, in .ci/run).
set -eu

missing() {
    while read -r package kind probe; do
        case "$kind" in
            command) command -v "$probe" >/dev/null || echo "$package" ;;
            file) [ -e "$probe" ] || echo "$package" ;;
        esac
    done < "$(dirname "$0")/packages.txt"
}

# Runs a command; its words only where it fails.
quietly() { words=$("$@" 2>&1) || echo "$words" >&2; }

wanted=$(missing | tr '\n' ' ')
[ -n "$wanted" ] || exit 0
if [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; then
    echo "make: installing the packages that tests need: $wanted"
    export DEBIAN_FRONTEND=noninteractive
    quietly apt-get update
    for package in $wanted; do  # one by one, so that one unknown package does not keep out the others
        quietly apt-get install -y --no-install-recommends -o DPkg::Lock::Timeout=300 "$package"
    done
fi
wanted=$(missing | tr '\n' ' ')
[ -z "$wanted" ] || echo "make: some tests will be skipped. To run them all: sudo apt-get install --no-install-recommends $wanted"
