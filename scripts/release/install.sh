#!/bin/sh
# Install biobot from this folder, without a network: install.sh [--prefix DIR] [--python PROGRAM] [--check] [--service ...]
#
# What is in this folder is checked against SHA256SUMS first. A virtual environment is made in PREFIX/VERSION, a fresh one each time (VERSION-2,
# VERSION-3, ...), so that what runs is never changed under its feet; one that could not be finished is taken away again (fresh_place.sh).
set -eu
umask 022
here=$(cd "$(dirname "$0")" && pwd)
for file in VERSION GLIBC ROOM SHA256SUMS fresh_place.sh; do
  [ -f "$here/$file" ] || { echo "error: there is no $file in $here: unpack the archive anew, and compare its SHA-256 before" >&2; exit 1; }
done
version=$(cat "$here/VERSION")
prefix=/opt/biobot
python=
only_check=
with_service=

usage() {
  cat <<EOF
usage: sh install.sh [options]

Install biobot $version into a virtual environment of its own. Nothing is fetched.

  --prefix DIR       where to (default: /opt/biobot); the environment is DIR/$version
  --python PROGRAM   which Python, 3.11 to 3.14 (default: the first of python3, python3.14, ... python3.11 that fits)
  --check            only see whether this folder is whole and fits this machine
  --service ...      then set up system services (root): all that follows goes to
                     biobot-gateway install-service, as in: --service --port serial:/dev/ttyUSB0 --site tent
  --help             say this
EOF
}
fail() { echo "error: $*" >&2; exit 1; }

while [ $# -gt 0 ]; do
  case $1 in
    --prefix) [ $# -ge 2 ] || { echo "error: --prefix wants a folder" >&2; exit 2; }; prefix=$2; shift 2 ;;
    --python) [ $# -ge 2 ] || { echo "error: --python wants a program" >&2; exit 2; }; python=$2; shift 2 ;;
    --check) only_check=yes; shift ;;
    --service) with_service=yes; shift; break ;;
    --help | -h) usage; exit 0 ;;
    *) echo "error: $1 is no option; sh install.sh --help lists them" >&2; exit 2 ;;
  esac
done
case $prefix in /*) ;; *) prefix=$PWD/$prefix ;; esac

# Services that cannot be set up here are told of before minutes go by; files below a --root want neither root nor systemd.
case " $* " in
  *" --root"*) ;;
  *)
    if [ -n "$with_service" ] && [ -z "$only_check" ]; then
      [ "$(id -u)" = 0 ] || fail "--service sets up system services and wants root: sudo sh install.sh ... --service ..."
      [ -d /run/systemd/system ] || fail "--service wants a machine that systemd started, and this is none: leave it out, and start the programs \
by what this machine has"
    fi
    ;;
esac

# What a Python says of itself: "3.11-x86_64" where it fits, else why not. A 32-bit Python on a 64-bit kernel is told by the size of its integers.
tell='
import os, sys, sysconfig
name, machine = "%d.%d" % sys.version_info[:2], os.uname().machine
glibc = os.confstr("CS_GNU_LIBC_VERSION") if "CS_GNU_LIBC_VERSION" in os.confstr_names else ""
if not (3, 11) <= sys.version_info[:2] < (3, 15): print("no: it is Python %s, and 3.11 to 3.14 are wanted" % name)
elif sys.implementation.name != "cpython" or sysconfig.get_config_var("Py_GIL_DISABLED"): print("no: it is not the usual CPython")
elif sys.maxsize < 2**32: print("no: it is a 32-bit Python, and a 64-bit system is wanted")
elif not glibc: print("no: its C library is not glibc (musl, as in Alpine Linux, has no wheels here)")
elif tuple(map(int, glibc.split()[1].split("."))) < tuple(map(int, sys.argv[1].split("."))):
    print("no: its C library is %s, and %s or newer is wanted: Debian 12, Ubuntu 24.04, Raspberry Pi OS 12" % (glibc, sys.argv[1]))
else: print(name + "-" + machine)
'
fits=
why=
for candidate in ${python:-python3 python3.14 python3.13 python3.12 python3.11}; do
  if ! command -v "$candidate" >/dev/null 2>&1; then
    [ -z "$python" ] || why=" there is no $candidate;"
    continue
  fi
  told=$("$candidate" -I -c "$tell" "$(cat "$here/GLIBC")" 2>/dev/null) || told="no: it does not start"
  case $told in
    '') why="$why $candidate: it is no Python;"; continue ;;
    no:*) why="$why $candidate: ${told#no: };"; continue ;;
    *) [ -f "$here/requirements/$told.txt" ] || { why="$why $candidate: this bundle has nothing for Python ${told%%-*} on ${told#*-};"; continue; } ;;
  esac
  fits=$told; python=$candidate; break
done
[ -n "$fits" ] || fail "no Python here that fits:${why:- there is none;} Debian 12 and Raspberry Pi OS 12 (64 bits) have 3.11. \
This bundle is for: $(cd "$here/requirements" && echo *.txt | sed 's/\.txt//g'); --python names a Python that is elsewhere"

command -v sha256sum >/dev/null 2>&1 || fail "no sha256sum here, which is in coreutils: without it this folder cannot be checked"
(cd "$here" && sha256sum --quiet -c SHA256SUMS >&2) || fail "this folder is not what was packed (above); copy it anew"
echo "biobot $version: this folder is whole; $(command -v "$python") fits ($fits)"
[ -z "$only_check" ] || exit 0

# shellcheck source=scripts/release/fresh_place.sh
. "$here/fresh_place.sh"
begin_place "" "$prefix" "$version" "$(cat "$here/ROOM")"

"$python" -I -m venv --without-pip "$place" || fail "$python cannot make a virtual environment in $place"
# pip reads no configuration and no variables here: it must find nothing but what is in this folder.
for name in $(env | sed -n 's/^\(PIP_[A-Z_]*\)=.*/\1/p'); do unset "$name"; done
pip=$(ls "$here"/wheels/pip-*.whl) || fail "there is no wheel of pip in $here/wheels; unpack the archive anew"
PYTHONPATH=$pip PIP_CONFIG_FILE=/dev/null "$place/bin/python" -m pip install --quiet --disable-pip-version-check --no-cache-dir --no-index \
  --find-links "$here/wheels" --no-deps --require-hashes --requirement "$here/requirements/$fits.txt" || fail "pip could not install (above); nothing of it stays"
# The list of fonts that this makes is of use to the user who installs for himself; of root's it would only stay behind.
[ "$(id -u)" != 0 ] || export MPLCONFIGDIR="$place/fonts"
"$place/bin/biobot-mapper" warm-up --quiet || fail "what was installed cannot make a map (above); nothing of it stays"
[ "$(id -u)" != 0 ] || rm -rf "$MPLCONFIGDIR"
unset MPLCONFIGDIR
finish_place

echo "installed in $place: $("$place/bin/biobot-gateway" --version)"
for other in "$prefix"/*/bin/biobot-gateway; do
  [ "$other" = "$place/bin/biobot-gateway" ] || [ ! -e "$other" ] || echo "there is ${other%/bin/biobot-gateway} as well, which stays as it is"
done
if [ -n "$with_service" ]; then
  "$place/bin/biobot-gateway" install-service "$@" && exit 0
  # A version that gave way to the one before is of no use; one that waits for a correction of its configuration is recorded.
  if grep -qs "\"programs\": \"$place\"" /var/lib/biobot/installed.json; then
    fail "not all services run yet (above); once that is corrected: sudo $place/bin/biobot-gateway install-service"
  fi
  drop_place
  fail "no service was changed, or those of before were put back (above); what was installed is removed again: correct that, and run this again"
fi
echo "to be rid of it: rm -r $place"
echo "try it: $place/bin/python -m studies.demo --exit --out ~/biobot-demo"
