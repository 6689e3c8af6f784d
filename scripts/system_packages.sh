#!/bin/sh
# Install what some tests want from Debian: a browser and a font, Wireshark's tshark, a compiler for ARM and an emulator. Without them those tests skip and say so.
set -eu
packages="chromium fonts-dejavu-core tshark"
[ "$(uname -m)" != x86_64 ] || packages="$packages gcc-aarch64-linux-gnu libc6-dev-arm64-cross qemu-user"
missing=
for package in $packages; do
  dpkg-query -W -f='${Status}' "$package" 2>/dev/null | grep -q 'ok installed' || missing="$missing $package"
done
[ -n "$missing" ] || exit 0
command -v apt-get >/dev/null || { echo "no apt-get here: the tests that want these will skip" >&2; exit 0; }
as_root=
if [ "$(id -u)" != 0 ]; then
  command -v sudo >/dev/null && sudo -n true 2>/dev/null || { echo "not root: run once as root: apt-get install -y$missing" >&2; exit 0; }
  as_root="sudo -n"
fi
$as_root apt-get update -qq || true
# shellcheck disable=SC2086  # the list is meant to be split
$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends $missing >/dev/null || {
  echo "could not install$missing: the tests that want these will skip" >&2; exit 0; }
