"""Words of column headings in five languages, and units with factors, from `vocabulary.toml`."""

import re
import tomllib
from collections.abc import Mapping
from importlib.resources import files

# Content of vocabulary.toml, as TOML has it.
_FILE = tomllib.loads(files("casadical.measurements").joinpath("vocabulary.toml").read_text(encoding="utf-8"))

# Word for a unit in a heading -> casadical's unit (mm, m, deg, rad, s, ...), and the factor to it.
UNITS: Mapping[str, tuple[str, float]] = {
    word: (str(ours), float(factor)) for factor, ours, words in _FILE["units"].values() for word in words.split()
}
# Role in a heading, such as joint, filler, measured, nominal or time -> words with this role.
WORDS: Mapping[str, frozenset[str]] = {kind: frozenset(words.split()) for kind, words in _FILE["words"].items()}

# All words of the vocabulary that are not ASCII, the longest first.
_NON_ASCII_WORDS = sorted(
    (w for w in {*UNITS, *frozenset().union(*WORDS.values())} if not w.isascii()), key=len, reverse=True
)
# Pattern that splits text of scripts without blanks (Chinese, Japanese) into its words, the
# longest first.
UNSPACED = re.compile("|".join(re.escape(w) for w in _NON_ASCII_WORDS if ord(w[0]) > 0x2E7F))


def hits(text: str) -> int:
    """Return the number of letters of a text in words of the vocabulary that are not ASCII.

    Of several decodings of one text, the correct one has the most.
    """
    return sum(map(len, re.compile("|".join(map(re.escape, _NON_ASCII_WORDS))).findall(text.casefold())))
