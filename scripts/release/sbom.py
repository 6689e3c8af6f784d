"""``make sbom``: a bill of materials in CycloneDX 1.6, from the lock files and from what lies in this source tree.

Required is what the services need (requirements/bundle.txt); what only development and tests need is there too, with the scope
"excluded", and so is what lies in the tree from others (axe-core, for tests of the page). Our own C sources and trained rules are
listed file by file with their hashes.
"""

import argparse
import hashlib
import json
import re
import sys
import uuid
import zipfile
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from email.message import Message
from email.parser import HeaderParser
from importlib import metadata
from pathlib import Path
from typing import Any

from packaging.utils import canonicalize_name, parse_wheel_filename

from scripts.release.lock_file import read_lock
from scripts.release.version import ROOT, read_version, source_moment

REQUIRED = ROOT / "requirements" / "bundle.txt"
NOT_SHIPPED = tuple(ROOT / "requirements" / f"{name}.txt" for name in ("build", "dev", "fuzz", "peers", "wire-peers"))
_OWN_C = ("simulator/engine", "mapper/kernels", "gateway/bulk", "firmware_protocol/c")
_AXE = Path("tests/vendor/axe-core/axe.min.js")
_NAMESPACE = uuid.UUID("6f7a5b3a-8a0e-5d6e-9f51-0b1c62696f62")

Component = dict[str, Any]


def make_sbom(*, lock: Path = REQUIRED, wheels: Sequence[Path] = (), others: Sequence[Path] = (), moment: int = 0) -> dict[str, Any]:
    """Make the bill of materials.

    Parameters
    ----------
    lock
        What is required.
    wheels
        The files of an offline bundle: they are listed with their hashes, and licences are taken from them.
    others
        Lock files of what is not shipped.
    moment
        When it was made [s, Unix time].

    Returns
    -------
    dict
        A CycloneDX 1.6 document. The same input makes the same document, its serial number too.
    """
    version = read_version()
    root = f"pkg:pypi/biobot-gateway@{version}"
    facts = _facts_of_wheels(wheels)
    components: dict[str, Component] = {}
    for path, scope in ((lock, "required"), *((path, "excluded") for path in others)):
        for pin in read_lock(path):
            purl = f"pkg:pypi/{canonicalize_name(pin.name)}@{pin.version}"
            components.setdefault(purl, _component(pin.name, pin.version, purl=purl, scope=scope, facts=facts, sha256s=pin.sha256s))
    for purl, files in _files_of_wheels(wheels).items():
        if purl in components:
            components[purl]["components"] = files
    if others:
        components["axe-core"] = _axe()
    document: dict[str, Any] = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "timestamp": datetime.fromtimestamp(moment, tz=UTC).isoformat(),
            "component": {
                "type": "application",
                "bom-ref": root,
                "name": "biobot-gateway",
                "version": version,
                "purl": root,
                "licenses": [{"license": {"id": "Apache-2.0"}}],
                "components": [*_own_files(), *_files_of_wheels(wheels).get(root, [])],
            },
            "lifecycles": [{"phase": "build"}],
        },
        "components": [components[purl] for purl in sorted(components)],
        "dependencies": _dependencies(root, {purl for purl in components if purl.startswith("pkg:")}, (lock, *others)),
    }
    serial = uuid.uuid5(_NAMESPACE, json.dumps(document, sort_keys=True))
    return {"bomFormat": "CycloneDX", "serialNumber": f"urn:uuid:{serial}", **document}


def write_sbom(document: dict[str, Any], path: Path) -> None:
    """Write the document for people and programs."""
    path.write_text(json.dumps(document, indent=1, ensure_ascii=False) + "\n")


def _component(name: str, version: str, *, purl: str, scope: str, facts: dict[str, Message], sha256s: Iterable[str]) -> Component:
    licences = _licences(facts.get(purl) or _installed_facts(name, version))
    hashes = [{"alg": "SHA-256", "content": digest} for digest in sha256s]
    return {
        "type": "library",
        "bom-ref": purl,
        "name": name,
        "version": version,
        "scope": scope,
        **({"licenses": licences} if licences else {}),
        "purl": purl,
        # What pip may take for it, whichever the machine: the hashes of all its files that were locked.
        "externalReferences": [{"type": "distribution", "url": purl, "hashes": hashes}],
    }


def _licences(facts: Message | None) -> list[dict[str, Any]]:
    """Return the licence as a package's own facts tell it: the SPDX expression, else the classifiers, else the first line of the field."""
    if facts is None:
        return []
    if expression := facts.get("License-Expression"):
        return [{"expression": expression}]
    names = [value.split(" :: ")[-1] for value in facts.get_all("Classifier", []) if value.startswith("License :: ")]
    names = [name for name in names if name != "OSI Approved"]
    told = (facts.get("License") or "").strip().splitlines()
    return [{"license": {"name": name}} for name in names or told[:1]]


def _installed_facts(name: str, version: str) -> Message | None:
    try:
        found = metadata.distribution(name)
    except metadata.PackageNotFoundError:
        return None
    return HeaderParser().parsestr(found.read_text("METADATA") or "") if found.version == version else None


def _facts_of_wheels(wheels: Iterable[Path]) -> dict[str, Message]:
    facts = {}
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as content:
            name = next(entry for entry in content.namelist() if re.fullmatch(r"[^/]+\.dist-info/METADATA", entry))
            facts[_purl(wheel)] = HeaderParser().parsestr(content.read(name).decode())
    return facts


def _files_of_wheels(wheels: Iterable[Path]) -> dict[str, list[Component]]:
    files: dict[str, list[Component]] = {}
    for wheel in wheels:
        files.setdefault(_purl(wheel), []).append(_file(wheel, name=wheel.name))
    return files


def _purl(wheel: Path) -> str:
    name, version, _, _ = parse_wheel_filename(wheel.name)
    return f"pkg:pypi/{name}@{version}"


def _own_files() -> list[Component]:
    sources = [path for folder in _OWN_C for path in (ROOT / folder).rglob("*.[ch]")]
    rules = list((ROOT / "mapper" / "data").glob("*.json"))
    return [_file(path, name=str(path.relative_to(ROOT))) for path in sorted((*sources, *rules))]


def _file(path: Path, *, name: str) -> Component:
    with path.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
    return {"type": "file", "bom-ref": f"file:{name}", "name": name, "hashes": [{"alg": "SHA-256", "content": digest}]}


def _axe() -> Component:
    head = (ROOT / _AXE).read_text()[:200]
    told = re.search(r"axe v([\d.]+)", head)
    if told is None:
        raise ValueError(f"{_AXE} does not say its version in its first line")
    return {
        **_file(ROOT / _AXE, name="axe-core"),
        "type": "library",
        "bom-ref": f"pkg:npm/axe-core@{told[1]}",
        "version": told[1],
        "scope": "excluded",
        "licenses": [{"license": {"id": "MPL-2.0"}}],
        "purl": f"pkg:npm/axe-core@{told[1]}",
        "properties": [{"name": "biobot:path", "value": str(_AXE)}],
    }


def _dependencies(root: str, purls: set[str], locks: Iterable[Path]) -> list[dict[str, Any]]:
    """Return who needs whom, by the "via" that lock files tell of each pin."""
    by_name: dict[str, set[str]] = {}
    for purl in purls:
        by_name.setdefault(purl.removeprefix("pkg:pypi/").split("@")[0], set()).add(purl)
    needs: dict[str, set[str]] = {purl: set() for purl in (root, *purls)}
    for path in locks:
        for entry in re.split(r"\n(?=[A-Za-z0-9])", path.read_text()):
            if (pinned := re.match(r"([A-Za-z0-9._-]+)==(\S+)", entry)) is None:
                continue
            purl = f"pkg:pypi/{canonicalize_name(pinned[1])}@{pinned[2]}"
            for told in re.findall(r"^    #(?: via|  ) +([A-Za-z0-9][A-Za-z0-9._-]*)(?: \(pyproject\.toml\))?$", entry, re.MULTILINE):
                for parent in {root} if told == "biobot-gateway" else by_name.get(canonicalize_name(told), set()):
                    needs[parent].add(purl)
    return [{"ref": purl, "dependsOn": sorted(needs[purl])} for purl in sorted(needs)]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the bill of materials of this source tree."""
    parser = argparse.ArgumentParser(prog="make sbom ARGS=...", description="Write a bill of materials in CycloneDX 1.6.")
    parser.add_argument(
        "--out", type=Path, default=Path("dist") / f"biobot-{read_version()}.cdx.json", help="where to (default: %(default)s)"
    )
    parser.add_argument("--shipped", action="store_true", help="leave out what only development and tests need")
    options = parser.parse_args(arguments)
    document = make_sbom(others=() if options.shipped else NOT_SHIPPED, moment=source_moment())
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_sbom(document, options.out)
    print(f"{options.out}: {len(document['components'])} components")
    return 0


if __name__ == "__main__":
    sys.exit(main())
