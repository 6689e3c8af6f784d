#!/bin/sh
# Make a virtual environment on a machine that may have nothing but python3.
#
# Debian keeps ensurepip in a package of its own, so "python3 -m venv" alone fails there. Tried in turn: ensurepip; the
# package python3-venv through apt-get (root or password-free sudo); the pip wheel out of Debian's python3-pip-whl package,
# unpacked without installing anything; and then a message that says what to do.
set -eu
python=${PYTHON:-python3}
venv=${1:-.venv}

command -v "$python" >/dev/null || { echo "error: no $python found; install Python 3.11 or newer, or set PYTHON" >&2; exit 1; }
"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' || {
  echo "error: $("$python" --version) is not supported; biobot needs Python 3.11 to 3.14 (set PYTHON=python3.x)" >&2; exit 1; }
if [ -x "$venv/bin/python" ] && "$venv/bin/python" -m pip --version >/dev/null 2>&1; then exit 0; fi

rm -rf "$venv"
if "$python" -c 'import ensurepip' 2>/dev/null; then exec "$python" -m venv "$venv"; fi

as_root=
if [ "$(id -u)" != 0 ]; then
  if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root="sudo -n"; else as_root=none; fi
fi
if command -v apt-get >/dev/null; then
  if [ "$as_root" != none ]; then
    install="$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends python3-venv"
    $install >/dev/null 2>&1 || { $as_root apt-get update -qq && $install >/dev/null; }
    exec "$python" -m venv "$venv"
  fi
  unpacked=$(mktemp -d)
  trap 'rm -rf "$unpacked"' EXIT
  if (cd "$unpacked" && apt-get download -qq python3-pip-whl 2>/dev/null && dpkg -x ./*.deb .); then
    "$python" -m venv --without-pip "$venv"
    wheel=$(ls "$unpacked"/usr/share/python-wheels/pip-*.whl)
    PYTHONPATH=$wheel "$venv/bin/python" -m pip install -q "$wheel"
    exit 0
  fi
fi
echo "error: this Python has no ensurepip; run once as root: apt-get install -y python3-venv" >&2
exit 1
