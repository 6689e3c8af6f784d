#!/bin/sh
# Pin every dependency with hashes: one file for building, one for development and tests, one for each service's image, one for the offline bundle with all
# services, one to put beside the first for what persistence is compared with, one for what the wire's dialects are held against.
# The files hold no addresses, so they work with whichever registry pip is set up for.
set -eu
command -v uv >/dev/null || { echo "error: uv is needed to resolve for all Python versions: pip install uv" >&2; exit 1; }
uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 requirements/build.in --output-file requirements/build.txt
for extra in dev gateway mapper simulator; do
  uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 --extra "$extra" pyproject.toml \
    requirements/build.in --output-file "requirements/$extra.txt"
done
uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 --extra gateway --extra mapper --extra simulator \
  --constraint requirements/dev.txt pyproject.toml requirements/bundle.in --output-file requirements/bundle.txt
uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 --extra peers --constraint requirements/dev.txt \
  pyproject.toml --output-file requirements/peers.txt
uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 --extra wire-peers --constraint requirements/dev.txt \
  pyproject.toml --output-file requirements/wire-peers.txt
uv pip compile --quiet --universal --generate-hashes --no-header --python-version 3.11 --extra fuzz --constraint requirements/dev.txt \
  pyproject.toml --output-file requirements/fuzz.txt
