#!/bin/sh
# Lay out a Debian with Python and a C compiler, to try a release in: system_tree.sh SUITE ARCHITECTURE FOLDER, as in: system_tree.sh bookworm arm64 build/trees/debian-12-arm64
#
# Its packages are unpacked and not configured, which needs no process of that system; Python works so. Wants debootstrap and a network.
set -eu
[ $# = 3 ] || { echo "usage: $0 SUITE ARCHITECTURE FOLDER" >&2; exit 2; }
suite=$1 architecture=$2 folder=$3
command -v debootstrap >/dev/null || { echo "error: no debootstrap here: apt-get install debootstrap" >&2; exit 1; }
[ ! -e "$folder" ] || { echo "error: $folder is there already" >&2; exit 1; }
mkdir -p "$(dirname "$folder")"
folder=$(cd "$(dirname "$folder")" && pwd)/$(basename "$folder")  # debootstrap works in other folders
script=/usr/share/debootstrap/scripts/$suite
[ -e "$script" ] || script=/usr/share/debootstrap/scripts/sid  # a suite that is younger than debootstrap
fetched=$folder.fetched
rm -rf "$fetched"
trap 'rm -rf "$fetched"' EXIT
# The mirror that this machine itself is set up for, where it has one.
mirror=${MIRROR:-$(apt-get indextargets --format '$(SITE)' 'Created-By: Packages' 2>/dev/null | grep -m1 '/debian/*$' || true)}
# shellcheck disable=SC2086  # no mirror: no argument
debootstrap --foreign --arch="$architecture" --variant=minbase --include=python3,python3-venv,gcc,libc6-dev "$suite" "$fetched" ${mirror:-} "$script" >&2
mkdir -p "$folder"
for name in bin sbin lib; do mkdir -p "$folder/usr/$name"; ln -s "usr/$name" "$folder/$name"; done
[ "$architecture" != amd64 ] || { mkdir -p "$folder/usr/lib64"; ln -s usr/lib64 "$folder/lib64"; }
for package in "$fetched"/var/cache/apt/archives/*.deb; do
  dpkg-deb --fsys-tarfile "$package" | tar -x --keep-directory-symlink -C "$folder"
done
mkdir -p "$folder/tmp" "$folder/proc" "$folder/dev"
echo "$folder"
