#!/bin/sh
# Make what compose.site.yaml mounts: an authority, and for each service its certificates and its configuration.
#
#   make_site.sh SITE HOST...   names and addresses of this machine, as others call it
#   make_site.sh renew          new certificates for all, of the same authority; then restart the services
#   make_site.sh roster         only copy the roster to the router, after certificates were issued or a line was taken away by hand
#
# Configuration that is there already stays as it is. It runs as root in the gateway's image, with the folder at /site (SITE_FOLDER elsewhere).
set -eu
umask 077
place=${SITE_FOLDER:-/site}
owner=${BIOBOT_UID:-10001}
pki=$place/pki
usage() { sed -n '4,6s/^# */usage: /p' "$0" >&2; exit 2; }

lay_roster() { mkdir -p "$place/router" && cp "$pki/roster.txt" "$place/router/roster.txt"; }

lay_certificates() {  # SERVICE FOLDER
  mkdir -p "$place/$1"
  for file in ca.pem certificate.pem key.pem; do cp "$2/$file" "$place/$1/$file"; done
}

lay_all() {
  site=$(cat "$place/site-name")
  lay_certificates router "$pki/all-sites/router/main"
  lay_certificates gateway "$pki/$site/gateway/base1"
  lay_certificates mapper "$pki/$site/mapper/map1"
  lay_certificates operator "$pki/$site/operator/console"
  lay_roster
}

tls() { printf '\n[tls]\nca = "/etc/biobot/ca.pem"\ncertificate = "/etc/biobot/certificate.pem"\nkey = "/etc/biobot/key.pem"\n'; }

write_once() {  # FILE, its text on standard input
  if [ -e "$1" ]; then echo "kept   $1"; cat >/dev/null; else cat >"$1"; echo "wrote  $1"; fi
}

configure() {
  write_once "$place/router/router.toml" <<TOML
listen = ["tls/0.0.0.0:7447"]
roster = "/etc/biobot/roster.txt"
$(tls)
TOML
  write_once "$place/gateway/gateway.toml" <<TOML
# biobot-gateway config print-default tells all keys; a dongle's dialect is in docs/dongles.md.
site = "$site"
name = "base1"
ports = ["serial:/dev/dongle?dialect=znp"]
journal = "/var/lib/biobot/gateway.sqlite"
listen = []
connect = ["tls/router:7447"]

[monitor]
listen = "127.0.0.1:9466"
$(tls)
TOML
  write_once "$place/mapper/mapper.toml" <<TOML
[serve]
site = "$site"
name = "map1"
connect = ["tls/router:7447"]
store = "/var/lib/biobot/mapper.sqlite"
host = "0.0.0.0"
port = 8443
allow_remote = true
certificate = "/etc/biobot/certificate.pem"
key = "/etc/biobot/key.pem"
$(tls)
TOML
  write_once "$place/operator/operator.toml" <<TOML
# biobot-gateway status --config operator.toml; on other machines with their address for the router's, and the paths of these files.
site = "$site"
connect = ["tls/router:7447"]
$(tls)
TOML
}

issue() { biobot-gateway certs issue "$pki" "$@" >/dev/null; }

case ${1:-} in
  '' | -*) usage ;;
  roster) [ $# = 1 ] || usage; lay_roster ;;
  renew)
    [ $# = 1 ] || usage
    site=$(cat "$place/site-name")
    issue router main --renew
    issue gateway base1 --site "$site" --renew
    issue mapper map1 --site "$site" --renew
    issue operator console --site "$site" --renew
    lay_all
    ;;
  *)
    [ $# -ge 2 ] || usage
    site=$1
    shift
    hosts=
    for host in "$@"; do hosts="$hosts --host $host"; done
    biobot-gateway certs init "$pki" --name "biobot authority of $site"
    # shellcheck disable=SC2086  # the list is meant to be split
    issue router main --host router $hosts
    issue gateway base1 --site "$site"
    # shellcheck disable=SC2086
    issue mapper map1 --site "$site" --host localhost --host 127.0.0.1 $hosts
    issue operator console --site "$site"
    echo "$site" >"$place/site-name"
    lay_all
    configure
    ;;
esac
cp "$pki/ca.pem" "$place/ca.pem"
chmod 755 "$place"
chmod 644 "$place/ca.pem"
chown -R "$owner:$owner" "$place/router" "$place/gateway" "$place/mapper" "$place/operator"
biobot-gateway certs check "$pki"
