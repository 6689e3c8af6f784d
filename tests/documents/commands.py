"""The commands of the documents: what stands in their blocks ``sh`` and ``console``, and between backquotes in their text."""

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
DOCUMENTS = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "firmware_protocol").rglob("*.md")),
    *sorted((ROOT / "mapper").rglob("*.md")),
]
PROGRAMS = {"biobot-gateway": "gateway", "biobot-mapper": "mapper", "biobot-sim": "simulator"}
OURS = (*PROGRAMS, "make", "curl", "python")
_OPERATORS = {"&&", "||", ";", "|", ">"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One command: its document and line, its words, and where its input comes from and its output goes, if that is said."""

    document: str
    line: str
    words: tuple[str, ...]
    source: str = ""
    target: str = ""

    @property
    def program(self) -> str:
        return Path(self.words[0]).name

    @property
    def text(self) -> str:
        return " ".join((self.program, *self.words[1:]))


def blocks(path: Path) -> Iterator[tuple[str, str]]:
    """Yield the language and text of every fenced block of a document."""
    yield from re.findall(r"^```(\w*)\n(.*?)^```", path.read_text(), re.DOTALL | re.MULTILINE)


def block_commands() -> list[Command]:
    """Return the commands of all blocks, in the order of documents and lines."""
    found: list[Command] = []
    for path in DOCUMENTS:
        for language, text in blocks(path):
            lines = text.replace("\\\n", " ").splitlines()
            if language == "console":
                lines = [line[2:] for line in lines if line.startswith("$ ")]
            elif language != "sh":
                continue
            found += [one for line in lines for one in _commands(line, document=str(path.relative_to(ROOT)))]
    return found


def inline_commands() -> list[Command]:
    """Return the commands of ours that stand between backquotes in the text; their words may be cut short by an ellipsis."""
    found: list[Command] = []
    for path in DOCUMENTS:
        text = re.sub(r"^```.*?^```", "", path.read_text(), flags=re.DOTALL | re.MULTILINE)
        for span in re.findall(r"`([^`\n]+)`", text):
            start = re.sub(r"^(\S+=\S* )*(\.venv/bin/)?", "", span)
            if start.split(" ")[0] in {*PROGRAMS, "make"} or start.startswith("python -m studies."):
                found += _commands(re.split(r" [|>&] ?", start)[0], document=str(path.relative_to(ROOT)))
    return found


def _commands(line: str, *, document: str) -> Iterator[Command]:
    """Take a line of shell apart; only what documents need is understood: comments, ``&&``, ``cat FILE |`` and ``> FILE``."""
    lexer = shlex.shlex(line, posix=True, punctuation_chars=False)
    lexer.whitespace_split = True
    lexer.commenters = ""
    words: list[str] = []
    for word in lexer:
        if word == "#":
            break
        words.append(word)
    source = ""
    if words[:1] == ["cat"] and words[2:3] == ["|"]:
        source, words = words[1], words[3:]
    while words:
        end = next((at for at, word in enumerate(words) if word in _OPERATORS), len(words))
        one, rest = words[:end], words[end:]
        target = ""
        if rest[:1] == [">"]:
            target, rest = rest[1], rest[2:]
        assert not rest or rest[0] == "&&", f"{document}: {line}: the test does not understand {rest[0]}"
        while re.match(r"[A-Z][A-Z0-9_]*=", one[0]) or one[0] == "sudo":
            one = one[1:]
        yield Command(document=document, line=line, words=tuple(one), source=source, target=target)
        words = rest[1:]
