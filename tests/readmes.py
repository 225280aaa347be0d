"""Code blocks and prose of a README."""

import re


def blocks_of(language, readme):
    """Return the code blocks of one language in a README, joined."""
    text = readme.read_text(encoding="utf-8")
    return "".join(re.findall(rf"^```{language}\n(.*?)^```", text, flags=re.MULTILINE | re.DOTALL))


def prose_of(readme):
    """Return the lines outside code blocks and tables, each with its number from 1."""
    prose, is_code = [], False
    for number, line in enumerate(readme.read_text(encoding="utf-8").splitlines(), start=1):
        if line.startswith("```"):
            is_code = not is_code
        elif not is_code and not line.startswith("|"):
            prose.append((number, line))
    return prose
