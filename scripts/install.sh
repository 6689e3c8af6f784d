#!/bin/sh
# Make a virtual environment and install pinned requirements into it: install.sh VENV FILE...
#
# What has no wheel for this machine is built with the pinned build tools of requirements/build.txt, never with others fetched for the occasion.
set -eu
venv=$1
shift
sh "$(dirname "$0")/bootstrap.sh" "$venv"
pip="$venv/bin/python -m pip install --quiet --disable-pip-version-check --require-hashes"
$pip -r requirements/build.txt
files=
for file in "$@"; do files="$files -r $file"; done
# shellcheck disable=SC2086  # the list is meant to be split
$pip --no-build-isolation $files
