"""A page as its parser reads it."""

from collections import defaultdict
from html.parser import HTMLParser


class Parsed(HTMLParser):
    """Texts by their tag, and what is loaded; the parser refuses nothing, so that open tags are counted."""

    EMPTY = ("meta", "link", "img", "br")

    def __init__(self, text: str) -> None:
        super().__init__()
        self.texts: dict[str, list[str]] = defaultdict(list)
        self.sources: list[str] = []
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs) -> None:
        self.sources += [v for k, v in attrs if k in ("src", "href") and not v.startswith(("#", "data:"))]
        if tag not in self.EMPTY:
            self.open.append(tag)

    def handle_endtag(self, tag) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data) -> None:
        if self.open:
            self.texts[self.open[-1]].append(data)
