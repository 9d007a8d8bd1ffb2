"""Plain technical English in pages, docstrings, comments and messages: words that tire a reader from abroad."""

import re
from collections.abc import Iterator
from pathlib import Path

from repository import ROOT, tracked

# A pattern, and what to write instead.
WORDS = {
    r"fore(?:tell|told)\w*|forecast anew": "predict",
    r"(?:bring|brings|brought) forth": "account for, produce",
    r"deaf": "robust to",
    r"holds? (?:its|their) tongue|speaks or": "claims nothing",
    r"Ipopt's word": "the solver's status",
    r"nothing installed but|nothing but": "requires only, only",
    r"to look at": "figures, HTML reports",
    r"part(?:ed|s|ing)? (?:them|by)": "separate, distinguish",
    r"(?:tell|tells|told|telling)(?: \w+| the \w+){0,2} apart": "distinguish",
    r"(?:can|cannot|could|to|not) be (?:told|had)": "determine, identify",
    r"tells? (?:it|them) (?:to|worse|best)": "determine",
    r"save for|but for": "except",
    r"anew": "again, re-estimated",
    r"mend(?:s|ed|ing)?": "correct, repair",
    r"lessen(?:s|ed)?": "reduce",
    r"dearer|dear": "more expensive",
    r"likel(?:ier|iest)": "more probable, most probable",
    r"somebody|whoever": "a user",
    r"of (?:ours|theirs)": "our, their",
    r"to the letter": "exactly, unchanged",
    r"wholly": "completely",
    r"rightly": "correctly",
    r"is worth (?:nothing|little)|worth no more": "useless, no more accurate than",
    r"sunk": "deflected",
    r"likewise|thereby|whence|lest|aught|naught": "also, thus",
    r"wont|unto|betwixt|amid": "usual, to, between",
    r"comes? back|goes? on with": "return, continue",
    r"in the dark about|heed\w*|reckon\w*": "without, regard, compute",
}
# Names of figures in score.json, whose files are committed.
ALLOWED = ("shrink foretold less realised",)
PATTERN = re.compile("|".join(rf"(?P<w{k}>\b(?:{word})\b)" for k, word in enumerate(WORDS)), re.IGNORECASE)
FILES = [
    path
    for path in tracked()
    if path.suffix in (".py", ".pyi", ".md", ".rst", ".toml", ".html", ".js", ".yml", ".cff", ".c", ".h", ".st")
    and path.parts[0] in ("casadical", "docs", "README.md", "problems", ".github", "CITATION.cff", "data")
    and not (path.parts[:2] == ("docs", "studies") and path.suffix == ".txt")
]


def unusual(path: Path) -> Iterator[str]:
    """Words of a file that tire its reader, with their lines and what to write instead."""
    for number, line in enumerate((ROOT / path).read_text(encoding="utf-8").splitlines(), 1):
        for match in PATTERN.finditer(line) if not any(words in line for words in ALLOWED) else ():
            instead = list(WORDS.values())[int(match.lastgroup[1:])]
            yield f"{path}:{number}: {match[0]!r}; rather: {instead}"


def test_plain_words() -> None:
    assert len(FILES) > 500
    assert [word for path in FILES for word in unusual(path)] == []
