# Copyright 2026 dlo_ros maintainers, SPDX-License-Identifier: Apache-2.0
"""Whole HTML: each element that is opened is closed again."""

from html.parser import HTMLParser

VOID = {"meta", "input", "br", "img", "link", "hr"}


class Checker(HTMLParser):
    """Fails on elements that are closed wrongly; keeps ids, addresses and the JSON of scripts."""

    def __init__(self):
        super().__init__()
        self.open, self.ids, self.addresses, self.scripts = [], [], [], []

    def handle_starttag(self, tag, attrs):
        values = dict(attrs)
        if "id" in values:
            self.ids.append(values["id"])
        for key in ("src", "href", "xlink:href", "action", "data"):
            if key in values:
                self.addresses.append(values[key])
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((values.get("type"), ""))

    def handle_startendtag(self, tag, attrs):
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag):
        assert self.open and self.open[-1] == tag, f"</{tag}> closes {self.open[-3:]}"
        self.open.pop()

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            kind, text = self.scripts[-1]
            self.scripts[-1] = (kind, text + data)


def checked(html):
    checker = Checker()
    checker.feed(html)
    checker.close()
    assert checker.open == []
    return checker
