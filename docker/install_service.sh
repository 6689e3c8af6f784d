#!/bin/sh
# In a build stage of the Dockerfile: install the pinned requirements of a service into /opt/biobot, and take away what it never opens.
#
# What has no wheel for this machine is built with the pinned tools that come first. They go afterwards, as do the libraries' own tests
# and what only compilers, debuggers and type checkers read; `pip check` tells whether anything that is left wants what has gone.
set -eu
pip="/opt/toolchain/bin/pip --python /opt/biobot/bin/python"
$pip install --no-cache-dir --require-hashes --requirement requirements/build.txt
$pip install --no-cache-dir --no-build-isolation --require-hashes --requirement "$1"
$pip uninstall --yes --quiet editables hatchling pathspec pluggy setuptools tomlkit trove-classifiers
$pip check
cd /opt/biobot
find . -depth -type d \( -name tests -o -name include \) -exec rm -r {} +
find . -type f \( -name '*.pyi' -o -name '*.pxd' -o -name '*.pyx' -o -name '*.h' \) -delete
# Libraries written in Rust come with the names of their inner symbols, which nobody looks up: a third of Zenoh's 33 MB.
find . -type f -name '*.abi3.so' -exec strip --strip-unneeded {} +
rm -rf lib/python3.11/site-packages/matplotlib/mpl-data/sample_data share
