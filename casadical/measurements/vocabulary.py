"""Words of column headings in five languages, and units with their factors, from `vocabulary.toml`."""

import re
import tomllib
from collections.abc import Mapping
from importlib.resources import files

_FILE = tomllib.loads(files("casadical.measurements").joinpath("vocabulary.toml").read_text(encoding="utf-8"))

# Unit -> our unit, and the factor to it.
UNITS: Mapping[str, tuple[str, float]] = {
    word: (str(ours), float(factor)) for factor, ours, words in _FILE["units"].values() for word in words.split()
}
# joint, filler, measured, nominal, about, temperature, time, load, target: words that a heading may have.
WORDS: Mapping[str, frozenset[str]] = {kind: frozenset(words.split()) for kind, words in _FILE["words"].items()}

_OTHER = sorted((w for w in {*UNITS, *frozenset().union(*WORDS.values())} if not w.isascii()), key=len, reverse=True)
# Scripts without blanks between words are cut into words that are known, the longest first.
UNSPACED = re.compile("|".join(re.escape(w) for w in _OTHER if ord(w[0]) > 0x2E7F))


def hits(text: str) -> int:
    """Letters of a text in known words that are not ASCII: of the readings of one text, the right one has most."""
    return sum(map(len, re.compile("|".join(map(re.escape, _OTHER))).findall(text.casefold())))
