"""Messages on stderr: three short lines for people, one line as in logs for tests."""

import re

MOST_LINES = 3
LONGEST_LINE = 160
"""Longest line of a message, without paths and lists of choices [characters]."""
_FIRST = re.compile(r"(error|warning): |(\[[-\d/]+\] )?(failed|not compared|left out) ")
_NEXT = re.compile(r"  \S")
_AS_LONG_AS_IT_IS = re.compile(r"\S*/\S*|(?<= one of).*")


def messages(err: str) -> list[list[str]]:
    """Return the lines of stderr; those of one message together."""
    groups: list[list[str]] = []
    for line in err.splitlines():
        if groups and _NEXT.match(line) and _FIRST.match(groups[-1][0]):
            groups[-1].append(line)
        else:
            groups.append([line])
    return groups


def check_messages(err: str) -> None:
    """Check that messages are short: what is wrong, why, and what to do."""
    for lines in messages(err):
        if _FIRST.match(lines[0]):
            assert len(lines) <= MOST_LINES, lines
            for line in lines:
                assert len(_AS_LONG_AS_IT_IS.sub("", line)) <= LONGEST_LINE, line


def folded(err: str) -> str:
    """Return stderr with every message in one line, as logs and JSON contain it.

    >>> folded("error: a.laz: is a folder\\n  expected a file\\n  hint: name a file\\n")
    'error: a.laz: is a folder, expected a file; name a file\\n'
    """
    text = ""
    for first, *others in messages(err):
        text += first
        for line in others:
            divider = ", " if re.match(r"  (expected|so)\b", line) else "; "
            text += divider + line.strip().removeprefix("hint: ")
        text += "\n"
    return text
