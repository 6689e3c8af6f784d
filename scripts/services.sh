#!/bin/sh
# Install this checkout as services of the machine, or remove them: services.sh install|uninstall [flag of install-service or uninstall-service]...
#
# Each version gets a virtual environment of its own, PREFIX/VERSION, so that the one that runs is untouched until the new one is complete, and is
# still there to go back to. PREFIX (/opt/biobot), DESTDIR (nothing) and SERVICES (gateway,mapper) come from the environment. Below a DESTDIR
# nothing is started and no user made.
set -eu
umask 022
here=$(cd "$(dirname "$0")/.." && pwd)
prefix=${PREFIX:-/opt/biobot}
root=${DESTDIR:-}
services=${SERVICES:-gateway,mapper}
action=$1
shift
# shellcheck source=scripts/release/fresh_place.sh
. "$here/scripts/release/fresh_place.sh"

case $root in '' | /*) ;; *) root=$PWD/$root ;; esac
case $prefix in /*) ;; *) echo "error: PREFIX is $prefix, and must begin with /" >&2; exit 2 ;; esac
if [ -z "$root" ] && [ "$(id -u)" != 0 ]; then
  echo "error: not root: sudo make $action, or DESTDIR=/some/folder for the files alone" >&2
  exit 1
fi

# What is installed takes 439 MB for gateway and mapper and 100 MB for a gateway alone (2026-11, du), and some more while it is made.
case ,$services, in *,mapper,*) room_mb=500 ;; *) room_mb=150 ;; esac

only_in() { # names of the packages that FILE pins and OTHER does not
  names='s/^\([a-z0-9][a-z0-9.-]*\)==.*/\1/p'
  sed -n "$names" "$1" | while read -r name; do grep -q "^$name==" "$2" || echo "$name"; done
}

install_services() {
  cd "$here"
  # The services' user must be able to run it, which one below somebody's home is not.
  if [ -z "${PYTHON:-}" ] && /usr/bin/python3 -c 'import sys; sys.exit(not (3, 11) <= sys.version_info < (3, 15))' 2>/dev/null; then
    export PYTHON=/usr/bin/python3
  fi
  sh scripts/compiler.sh
  version=$(sed -n 's/^version = "\(.*\)"$/\1/p' pyproject.toml)
  begin_place "$root" "$prefix" "$version" "$room_mb"
  files=
  for service in gateway mapper; do case ,$services, in *,$service,*) files="$files requirements/$service.txt" ;; esac; done
  # shellcheck disable=SC2086  # the list is meant to be split
  sh scripts/install.sh "$place" ${files:-requirements/gateway.txt}
  mkdir "$place/source"
  cp -R firmware_protocol gateway mapper simulator studies hatch_build.py pyproject.toml README.md LICENSE "$place/source"
  pip="$place/bin/python -m pip"
  $pip install --quiet --disable-pip-version-check --no-build-isolation --no-deps "$place/source"
  rm -rf "$place/source"
  # What is built with is of no use to what runs, and is not in the bundle either (requirements/bundle.txt).
  # shellcheck disable=SC2046  # the list is meant to be split
  $pip uninstall --quiet --yes $(only_in requirements/build.txt requirements/bundle.txt) 2>/dev/null
  checked=$($pip check) || { echo "error: what was installed does not fit together: $checked" >&2; exit 1; }
  finish_place
  if [ -n "$root" ]; then
    # What pip wrote names the folder where it was made; on the installed system it is elsewhere.
    grep -rlI --include='*' "$place" "$place/bin" "$place/pyvenv.cfg" | while read -r file; do sed -i "s|$place|$programs|g" "$file"; done
    set -- --root "$root" --programs "$programs" "$@"
  fi
  if ! "$place/bin/python" -m gateway install-service --services "$services" "$@"; then
    # A version that gave way to the one before is of no use; one that waits for a correction of its configuration is recorded.
    grep -qs "\"programs\": \"$programs\"" "$root/var/lib/biobot/installed.json" || drop_place
    exit 1
  fi
}

uninstall_services() {
  cd /
  made=$(cat "$root$prefix"/*/folders-made 2>/dev/null || true)
  for mark in "$root$prefix"/.*.unfinished; do [ ! -f "$mark" ] || made="$made
$(sed 1d "$mark")"; done
  for python in "$root$prefix"/*/bin/python; do
    [ -x "$(dirname "$python")/biobot-gateway" ] || continue
    "$python" -m gateway uninstall-service ${root:+--root "$root"} "$@"
    break
  done
  for place in "$root$prefix"/*; do
    if [ -e "$place/pyvenv.cfg" ] && { [ -e "$place/bin/biobot-gateway" ] || [ -e "$root$prefix/.${place##*/}.unfinished" ]; }; then rm -rf "$place"; fi
  done
  rm -f "$root$prefix"/.*.unfinished
  remove_made "$root" "$made
$prefix"
}

case $action in
  install) install_services "$@" ;;
  uninstall) uninstall_services "$@" ;;
  *) echo "error: $action is neither install nor uninstall" >&2; exit 2 ;;
esac
