#!/bin/sh
# See to a C compiler that works: the simulator's engine is compiled when the package is installed. Debian's gcc alone lacks the
# headers of the C library, which are in libc6-dev.
set -eu
works() {
  for compiler in ${CC:-cc gcc clang}; do
    command -v "$compiler" >/dev/null 2>&1 || continue
    made=$(mktemp)
    if printf '#include <math.h>\n#include <stdint.h>\n#include <stdlib.h>\ndouble f(double x) { return sqrt(x); }\n' |
      "$compiler" -x c -fPIC -shared - -o "$made" -lm 2>/dev/null; then rm -f "$made"; return 0; fi
    rm -f "$made"
  done
  return 1
}
works && exit 0
as_root=
if [ "$(id -u)" != 0 ]; then
  if command -v sudo >/dev/null && sudo -n true 2>/dev/null; then as_root="sudo -n"; else as_root=none; fi
fi
if command -v apt-get >/dev/null && [ "$as_root" != none ]; then
  install="$as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends gcc libc6-dev"
  $install >/dev/null 2>&1 || { $as_root apt-get update -qq && $install >/dev/null; }
  works && exit 0
fi
echo "error: no C compiler that works; run once as root: apt-get install -y gcc libc6-dev (or set CC)" >&2
exit 1
