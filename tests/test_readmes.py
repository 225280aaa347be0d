"""The READMEs can be read to their ends, and what they point at is there."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import pytest

from tests.readmes import blocks_of, prose_of
from tools.readmes import READMES, ROOT

if TYPE_CHECKING:
    from pathlib import Path

PACKAGES = sorted(
    path.parent
    for pattern in ("hickory_stream/*/__init__.py", "players/__init__.py", "players/*/__init__.py")
    for path in ROOT.glob(pattern)
)
# Where a name of a file may be meant from: the README's own folder, the checkout, and the packages.
PLACES = (ROOT, *(ROOT / folder for folder in ("hickory_stream", "tests", "tests/conformance", "tests/examples")))
NAMES = [str(readme.relative_to(ROOT)) for readme in READMES]


def test_the_projects_readme_is_read_to_its_end() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 160


@pytest.mark.parametrize("package", PACKAGES, ids=lambda package: str(package.relative_to(ROOT)))
def test_every_package_has_a_readme_that_says_how_to_extend_it_and_is_linked(package: Path) -> None:
    text = (package / "README.md").read_text(encoding="utf-8")
    assert "How to extend it" in text
    assert f"]({package.relative_to(ROOT)}/README.md)" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_lines_of_prose_have_120_characters_at_most(readme: Path) -> None:
    assert [number for number, line in prose_of(readme) if len(line) > 120] == []


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_what_a_readme_links_to_is_there(readme: Path) -> None:
    text = readme.read_text(encoding="utf-8")
    targets = [target for target in re.findall(r"\]\(([^)#]+)\)", text) if "://" not in target]
    assert [target for target in targets if not (readme.parent / target).exists()] == []


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_the_files_that_a_readme_names_are_there(readme: Path) -> None:
    text = re.sub(r"^```.*?^```", "", readme.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    named = set(re.findall(r"`([\w./-]+\.(?:py|toml))`", text)) | set(re.findall(r"`(tools/\w+)[` ]", text))
    places = (readme.parent, *readme.parent.parents, *PLACES)
    assert sorted(name for name in named if not any((place / name).exists() for place in places)) == []


@pytest.mark.parametrize("readme", READMES, ids=NAMES)
def test_the_python_of_a_readme_is_python(readme: Path) -> None:
    compile(blocks_of("python", readme), str(readme), "exec")
