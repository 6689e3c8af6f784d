# Read in by install.sh of the offline bundle and by scripts/services.sh: a folder of its own for each installation of a version.
# shellcheck shell=sh
#
#   begin_place ROOT PREFIX VERSION MEGABYTES    make PREFIX/VERSION (or VERSION-2, ...) below ROOT, where there is room for it; sets $programs,
#                                                its name on the installed system, and $place, where it is now
#   finish_place                                 what is in it is whole, and stays
#   drop_place                                   take it away
#
# Whatever ends this process before it is whole takes it away. A mark beside it, PREFIX/.VERSION.unfinished, tells the next installation what a
# SIGKILL or a loss of power left: the number of the process, then folders above that were made for it. PREFIX/VERSION/folders-made has those too,
# so that a removal leaves none of them.

begin_place() {
  _root=$1 _prefix=$2 _made=
  _drop_unfinished
  _check_room "$4"
  programs=$_prefix/$3
  _number=1
  while [ -e "$_root$programs" ]; do _number=$((_number + 1)); programs=$_prefix/$3-$_number; done
  place=$_root$programs
  _mark=$_root$_prefix/.${programs##*/}.unfinished
  _above=$_prefix
  while [ "$_above" != / ] && [ ! -e "$_root$_above" ]; do
    _made="$_above
$_made"
    _above=$(dirname "$_above")
  done
  # shellcheck disable=SC2154  # assigned in it
  trap '_status=$?; trap - EXIT; drop_place; exit $_status' EXIT
  trap 'exit 130' INT
  trap 'exit 143' TERM HUP
  if ! { mkdir -p "$_root$_prefix" && printf '%s\n%s' $$ "$_made" >"$_mark" && mkdir "$place"; } 2>/dev/null; then
    echo "error: $place cannot be made: run this as root, or name a folder of yours with --prefix (PREFIX= of make install)" >&2
    exit 1
  fi
}

finish_place() {
  printf %s "$_made" >"$place/folders-made"
  rm -f "$_mark"
  trap - EXIT INT TERM HUP
}

drop_place() {
  rm -rf "$place" "$_mark"
  remove_made "$_root" "$_made"
}

remove_made() { # below ROOT those of FOLDERS, one a line, in which nothing is left, the inner ones first
  printf '%s\n' "$2" | sort -ru | while read -r _folder; do [ -z "$_folder" ] || rmdir "$1$_folder" 2>/dev/null || true; done
}

_drop_unfinished() {
  for _mark in "$_root$_prefix"/.*.unfinished; do
    [ -f "$_mark" ] || continue
    place=${_mark##*/.}
    place=$_root$_prefix/${place%.unfinished}
    _owner=$(head -n 1 "$_mark")
    _running=/proc/${_owner:-none}/cmdline
    if [ -r "$_running" ] && tr '\0' ' ' <"$_running" | grep -q 'install\.sh\|services\.sh'; then
      echo "error: process $_owner is installing into $place now; wait until it is done" >&2
      exit 1
    fi
    echo "an installation into $place was interrupted; it is removed"
    _made="$_made$(sed 1d "$_mark")
"
    rm -rf "$place" "$_mark"
  done
}

_check_room() {
  _there=$_root$_prefix
  while [ ! -e "$_there" ]; do _there=$(dirname "$_there"); done
  _free=$(($(df -Pk "$_there" | tail -n 1 | tr -s ' ' | cut -d ' ' -f 4) / 1000))
  if [ "$_free" -lt "$1" ]; then
    echo "error: $_free MB are free at $_there, and an installation takes $1 MB: make room, or name a folder on another disk with --prefix" \
      "(PREFIX= of make install)" >&2
    exit 1
  fi
}
