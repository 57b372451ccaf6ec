#!/bin/sh
# Makes .venv with a Python >= 3.11. Says plainly what is missing, and installs it where that is allowed (root, apt).
set -eu

venv=${1:?usage: make_venv.sh FOLDER}

new_enough() { "$1" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; }
has_venv() { "$1" -c 'import venv; from ensurepip import version' 2>/dev/null; }

# Sets `python` to the best interpreter: one that can make an environment, else one that is only new enough.
find_python() {
    python=
    for candidate in ${PYTHON:-python3.13 python3.12 python3.11 python3 /usr/bin/python3}; do
        new_enough "$candidate" || continue
        if has_venv "$candidate"; then python=$candidate; return; fi
        [ -n "$python" ] || python=$candidate
    done
}

apt_install() {
    echo "make: installing the Debian packages $*"
    export DEBIAN_FRONTEND=noninteractive
    words=$( (apt-get update && apt-get install -y --no-install-recommends -o DPkg::Lock::Timeout=300 "$@") 2>&1) ||
        echo "$words" >&2
}

can_install() { [ "$(id -u)" = 0 ] && command -v apt-get >/dev/null; }

find_python
if [ -z "$python" ] && [ -z "${PYTHON:-}" ] && can_install; then
    apt_install python3 python3-venv
    find_python
fi
if [ -z "$python" ]; then
    echo "error: thetacomp needs Python 3.11 or newer, and none was found (tried: ${PYTHON:-python3.13 python3.12 python3.11 python3})." >&2
    echo "Fix on Debian 12 or 13 and Ubuntu 24.04 or newer: sudo apt-get install python3 python3-venv" >&2
    echo "Or name one: make PYTHON=/path/to/python3.12 ..." >&2
    exit 1
fi
if ! has_venv "$python"; then
    package=$("$python" -c 'import sys; print("python%d.%d-venv" % sys.version_info[:2])')
    if can_install; then apt_install "$package"; fi
    if ! has_venv "$python"; then
        echo "error: $python cannot make an environment: its module ensurepip is missing." >&2
        echo "Fix on Debian or Ubuntu: sudo apt-get install $package" >&2
        exit 1
    fi
fi

echo "make: $("$python" --version), environment in $venv"
rm -rf "$venv"
"$python" -m venv "$venv"
